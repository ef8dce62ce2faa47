"""The drives of the WAM: motor encoders, velocity filter, torque command.

Joints 2 and 3 share motors 2 and 3 through a differential, so both measuring and acting happen at the motors:

    θ_motor = T q,   τ_joint = Tᵀ τ_motor

T is libbarrett's joint-to-motor matrix; the scalar functions take it as data of the chain's four joints.
"""

from math import exp, pi
from typing import Any, NamedTuple

from jaxmpc.law.scalar import Matrix, Scalar, Vector, apply, apply_transposed, scale, sub
from jaxmpc.world.quantise import quantise

N1, N2, N3, N4 = 42.0, 28.25, 16.8155, 18.0
"""Transmission ratios per motor (libbarrett, wam4.conf); N3 is N2/n3."""
JOINT_TO_MOTOR: Matrix = ((-N1, 0.0, 0.0, 0.0), (0.0, N2, -N3, 0.0), (0.0, -N2, -N3, 0.0), (0.0, 0.0, 0.0, -N4))
MOTOR_TO_JOINT: Matrix = (
    (-1.0 / N1, 0.0, 0.0, 0.0),
    (0.0, 0.5 / N2, -0.5 / N2, 0.0),
    (0.0, -0.5 / N3, -0.5 / N3, 0.0),
    (0.0, 0.0, 0.0, -1.0 / N4),
)
IPNM = 2700.0
"""Puck torque units per motor torque [1/(N m)] (libbarrett's default)."""
TORQUE_LIMIT = (4860 / IPNM, 4860 / IPNM, 4860 / IPNM, 4320 / IPNM)
"""Motor torque at the pucks' cap MT [N m] (btutil defaults)."""


class Drive(NamedTuple):
    """Constants; each scalar may be a batch."""

    T_s: Scalar
    """Sampling time [s]."""
    angle_lsb: Scalar
    """Motor angle per encoder count [rad]; 0 is a perfect encoder."""
    velocity_pole: Scalar
    """Pole of the velocity low-pass [-]; 0 passes everything."""
    torque_lsb: Scalar
    """Motor torque per unit of the command [N m]; 0 is a perfect one."""
    torque_limit: Vector
    """Largest motor torque, 4 scalars [N m]."""


class DriveState(NamedTuple):
    """What the drives remember between two samples."""

    angle: Vector
    """Measured joint angles [rad]."""
    velocity: Vector
    """Filtered joint velocities [rad/s]."""


def angle_lsb(counts: int) -> float:
    """Motor angle per count [rad] of an encoder with so many per turn; 0 counts is a perfect encoder."""
    return 2.0 * pi / counts if counts else 0.0


def pole(cutoff: float, T_s: float) -> float:
    """Pole of a first-order low-pass with a cut-off [rad/s]; none for 0."""
    return exp(-cutoff * T_s) if cutoff else 0.0


def read(drive: Drive, q: Vector, ops: Any) -> Vector:
    """Joint angles as the motor encoders see them [rad]."""
    return apply(MOTOR_TO_JOINT, tuple(quantise(angle, drive.angle_lsb, ops) for angle in apply(JOINT_TO_MOTOR, q)))


def measure(drive: Drive, state: DriveState, q: Vector, ops: Any) -> DriveState:
    """Angles and filtered backward-difference velocities at a sample, from the joint angles q [rad]."""
    angle = read(drive, q, ops)
    raw = scale(1.0 / drive.T_s, sub(angle, state.angle))
    velocity = tuple(new + drive.velocity_pole * (old - new) for new, old in zip(raw, state.velocity, strict=True))
    return DriveState(angle, velocity)


def command(drive: Drive, torque: Vector, ops: Any) -> tuple[Vector, Vector]:
    """What the drives make of wanted joint torques [N m].

    Returns:
        The torques within the motors' limits, and those really sent, rounded down to whole units.
    """
    motor = apply_transposed(MOTOR_TO_JOINT, torque)
    held = tuple(ops.clip(value, -limit, limit) for value, limit in zip(motor, drive.torque_limit, strict=True))
    sent = tuple(quantise(value, drive.torque_lsb, ops, 0.0) for value in held)
    return apply_transposed(JOINT_TO_MOTOR, held), apply_transposed(JOINT_TO_MOTOR, sent)
