"""What a cycle has measured of the arm."""

from typing import NamedTuple

from deploy.puck.messages import PropertyReply
from deploy.puck.pendant import Pendant
from jaxmpc.law.vectors import Vector3


class Reading(NamedTuple):
    """Measurements of one cycle. Motors count from 1 to 4 as in the packed torque.

    Attributes:
        counts: Count of each motor's encoder in this cycle, or in the last if its reply has come only now; None where
            none came, or none that can be true.
        position_age: Cycles since the motor's last accepted counts, 0 if they are of this one.
        force: This cycle's force on the tissue in the world's frame [N], or None.
        force_age: Cycles since there was one.
        force_flags: Of this cycle's force, see `deploy.force.sensor`; 0 without one.
        safety_mode: Of the safety module: 0 e-stop, 1 idle, 2 active; None before its first answer.
        pendant: As last shown, None before the first answer.
        safety_age: Cycles since the safety module's last answer; it is asked every 10.
        puck_status: STAT of each puck as last reported: 0 reset, 1 error, 2 ready.
        puck_mode: MODE of each puck as last reported: 0 idle, 2 torque; None before its first answer.
        other: All properties told in this cycle.
        puck_age: Cycles since each puck last told STAT or MODE; it is asked twice in 16 polls.
    """

    counts: tuple[int | None, ...]
    position_age: tuple[int, ...]
    force: Vector3 | None
    force_age: int
    force_flags: int
    safety_mode: int | None
    pendant: Pendant | None
    safety_age: int
    puck_status: tuple[int, ...]
    puck_mode: tuple[int | None, ...]
    other: tuple[PropertyReply, ...]
    puck_age: tuple[int, ...] = (0, 0, 0, 0)
