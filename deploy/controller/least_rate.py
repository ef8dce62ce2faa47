"""Slowest change of torque that leaves a way from one torque to the next: pucks take whole units, rounded towards −∞.

With e₁…₄ in [0, 1/IPNM] what the motors lose and N the transmission ratios, the joints get

    τ₁ + N₁ e₁,   τ₂ + N₂ (e₃ − e₂),   τ₃ + N₃ (e₂ + e₃),   τ₄ + N₄ e₄

so a change within the limit must bear that, and what brings the torque sent last back within every other limit.
"""

from collections.abc import Sequence
from typing import Final

from deploy.controller.limits import Limits
from jaxmpc.files.errors import InputError
from jaxmpc.law.transmission import N1, N2, N3, N4
from jaxmpc.law.vectors import Vector4

SLACK = 1e-9
"""For the rounding of floating-point arithmetic [N m]."""
IPNM_RANGE: Final = (2000, 3500)
"""Torque units per N m that any source knows of, 2472 to 2755, and some room [1/(N m)] (wam.md §2.5)."""
CAPPED: Final = 0.9
"""Least share of the torque that a controller counts on with which it is still flown [-]: torque is known to a tenth
(docs/robot.md), and caps of known arms lie at 0.98 to 1.09 of it (MT 4860 units, IPNM 2472 to 2755, wam.md §2.5)."""


def lost(ipnm: Sequence[float]) -> Vector4:
    """What rounding changes of the joints' torques at most (4,) [N m].

    Args:
        ipnm: Units per motor torque of motors 1–4 (4,) [1/(N m)].
    """
    e1, e2, e3, e4 = (1.0 / units for units in ipnm)
    return N1 * e1, N2 * max(e2, e3), N3 * (e2 + e3), N4 * e4


def check_rates(limits: Limits, T_s: float, ipnm: Sequence[float], share: float = 1.0) -> None:
    """Refuse limits that close the way from one torque to the next.

    Args:
        limits: What may not be exceeded.
        T_s: Time between two frames [s].
        ipnm: Units per motor torque of motors 1–4 (4,) [1/(N m)].
        share: Of the torque that motors and joints need, what the pucks give [-].

    Raises:
        InputError: A rate is so slow.
    """
    change = lost(ipnm)
    of_motors = [1.0 / (units * most) for units, most in zip(ipnm, limits.motor_torque, strict=True)]
    of_joints = [each / most for each, most in zip(change, limits.joint_torque, strict=True)]
    shrink = max(*of_motors, *of_joints) / share
    for i, (rate, each, most) in enumerate(zip(limits.torque_rate, change, limits.joint_torque, strict=True)):
        least = (each + shrink * most + 4.0 * SLACK) / T_s
        if rate < least:
            remedy = "Allow a faster change, or more torque where the limit is smallest."
            raise InputError(f"limits.torque_rate[{i}]", rate, f"at least {least:.3g} N m/s at this rate", remedy)
