"""Home: the pose in which an arm that has lost its position is told where it is, and what shows it was another."""

from collections.abc import Sequence
from math import floor, pi
from typing import Final

from deploy.controller.limits import MECHANICAL_STOPS
from deploy.errors import CalibrationError
from deploy.puck import properties
from deploy.puck.codec import SAFETY_MODULE
from deploy.puck.frame import Frame
from deploy.wam.dialogue import Dialogue
from deploy.wam.pucks import Pucks
from jaxmpc.law.scalar import apply
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.law.vectors import Vector4

HOME: Final[Vector4] = (0.0, -2.0, 0.0, 3.13)
"""Joint angles of libbarrett's home position [rad]."""
STOP_TOLERANCE: Final = 0.19
"""Half a turn of the motor that turns its joint furthest [rad]: what homing can be wrong by (wam.md §1.3)."""


def set_home(
    talk: Dialogue, pucks: Pucks, question: Frame, zero: int, home: Sequence[float], zero_angles: Sequence[float] | None
) -> None:
    """Tell an arm that stands at home where it is, and see that it was understood.

    Args:
        talk: With the arm, whose safety module has been told to ignore velocities.
        pucks: As read.
        question: Asks all of them for their positions.
        zero: Number of the safety module's property ZERO.
        home: Joint angles there (4,) [rad].
        zero_angles: Motor angles of the zero calibration (4,) [rad]; None without one.

    Raises:
        CalibrationError: It was not taken, or a puck has no absolute encoder for the calibration.
        BusError: Somebody does not answer.
    """
    counts = pucks.counts(_corrected(talk, pucks, home, zero_angles))
    for info, count in zip(pucks.infos, counts, strict=True):
        talk.order(info.node, info.number("P"), count, then_s=0.001)
    now = talk.ask_positions(question, pucks.nodes)
    taken = now is not None and all(
        abs(a - b) < info.counts_per_turn // 8 for a, b, info in zip(now, counts, pucks.infos, strict=True)
    )
    if taken:  # and only then: the next program believes what the module says, whatever becomes of this one
        talk.order(SAFETY_MODULE, zero, 1, then_s=0.015)
        taken = talk.must(SAFETY_MODULE, zero) == 1
    if not taken:
        raise CalibrationError("the home position was not taken: hold the arm still and start again")


def _corrected(talk: Dialogue, pucks: Pucks, home: Sequence[float], zero: Sequence[float] | None) -> Sequence[float]:
    """Joint angles of home, corrected by where the absolute encoders stand in their turn.

        home − M wrap(T home + zero − 2π MECH/CTS)

    Raises:
        CalibrationError: A puck cannot tell that.
    """
    if zero is None:
        return home
    errors = []
    for info, motor, angle in zip(pucks.infos, apply(JOINT_TO_MOTOR, tuple(map(float, home))), zero, strict=True):
        if info.version < 118 or not info.role & properties.ROLE_ABSOLUTE_ENCODER:
            remedy = "start without a zero calibration"
            raise CalibrationError(f"puck {info.node} has no absolute encoder, or firmware before 118: {remedy}")
        mech = talk.must(info.node, info.number("MECH"))
        error = motor + angle - 2.0 * pi * mech / info.counts_per_turn
        errors.append(error - 2.0 * pi * floor(error / (2.0 * pi) + 0.5))
    return [angle - error for angle, error in zip(home, apply(MOTOR_TO_JOINT, tuple(errors)), strict=True)]


def within_stops(angles: Vector4) -> None:
    """Refuse joint angles that no arm has [rad] (4,).

    Raises:
        CalibrationError: One lies beyond its stops.
    """
    for joint, (angle, (low, high)) in enumerate(zip(angles, MECHANICAL_STOPS, strict=True), start=1):
        if not low - STOP_TOLERANCE <= angle <= high + STOP_TOLERANCE:
            said = f"joint {joint} says {angle:.2f} rad, beyond its stops at {low} and {high}"
            raise CalibrationError(f"{said}: the home position was wrong, press the e-stop, release it and home again")
