"""The drives of the WAM: motor encoders that count, torque commands in whole units.

Both happen at the motors, which joints 2 and 3 share (`jaxmpc.law.transmission`).
"""

from math import pi
from typing import NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, apply, apply_transposed
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.world.quantise import quantise


class Drive(NamedTuple):
    """Constants; each may be a batch."""

    angle_lsb: Scalar
    """Motor angle per encoder count [rad]; 0 is a perfect encoder."""
    torque_lsb: Scalar
    """Motor torque per unit of the command [N m]; 0 is a perfect one."""


def angle_lsb(counts: int) -> float:
    """Motor angle per count [rad] of an encoder with so many per turn; 0 counts is a perfect encoder."""
    return 2.0 * pi / counts if counts else 0.0


def read(drive: Drive, q: Vector, ops: Ops) -> Vector:
    """Joint angles as the motor encoders see them [rad]."""
    return apply(MOTOR_TO_JOINT, tuple(quantise(angle, drive.angle_lsb, ops) for angle in apply(JOINT_TO_MOTOR, q)))


def send(drive: Drive, torque: Vector, ops: Ops) -> Vector:
    """Joint torques that the drives make of a command [N m]: rounded down to whole units at the motors."""
    motor = apply_transposed(MOTOR_TO_JOINT, torque)
    sent = tuple(quantise(value, drive.torque_lsb, ops, 0.0) for value in motor)
    return apply_transposed(JOINT_TO_MOTOR, sent)
