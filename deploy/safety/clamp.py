"""Torques within their limits: magnitude, rate, and the two motors that joints 2 and 3 share.

The pucks take whole units, rounded towards −∞ (libbarrett), so every bound is drawn in by what rounding may change
(`deploy.controller.least_rate`).

Joints 2 and 3 must stay where |τ₂/(2 N₂) ∓ τ₃/(2 N₃)| is below the limits of motors 2 and 3. Outside, both are
scaled down together, which keeps their direction. Where the rate forbids that, they go towards the scaled torque from
what was sent last, as far as the rate allows. All these sets are convex, contain zero, and contain what was sent last
but for the rounding: shrinking that towards zero by `shrink` brings it inside. So the way onward is never closed, and
neither is the way to zero or to gravity's torque.
"""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from deploy.controller.least_rate import SLACK, check_rates, lost
from deploy.controller.limits import Limits
from jaxmpc.law.transmission import N1, N2, N3, N4
from jaxmpc.law.vectors import Vector4


class Bounds(NamedTuple):
    """Limits, drawn in by what rounding to puck units may change."""

    torque: Vector4
    """Largest torques of the joints [N m]; those of J1 and J4 also by their own motors."""
    step: Vector4
    """Largest change of a joint's torque in a cycle [N m]."""
    motor2: float
    """[N m]"""
    motor3: float
    """[N m]"""


class Clamp(NamedTuple):
    """Limits that acted."""

    finite: bool = False
    """A wanted torque was not a finite number; zero torque was wanted instead."""
    magnitude: bool = False
    rate: bool = False
    motors: bool = False
    """Those that joints 2 and 3 share."""

    @property
    def acted(self) -> bool:
        """Whether the torques differ from those wanted."""
        return self.finite or self.magnitude or self.rate or self.motors


NOTHING = Clamp()


def bounds(limits: Limits, T_s: float, ipnm: Sequence[float]) -> Bounds:
    """Bounds for `clamp`, computed once before motion.

    Args:
        limits: What may not be exceeded.
        T_s: Time between two frames [s].
        ipnm: Units per motor torque of motors 1–4, as the pucks say (4,) [1/(N m)].

    Raises:
        InputError: A rate is so slow that rounding could close the way from one torque to the next.
    """
    check_rates(limits, T_s, ipnm)
    e1, e2, e3, e4 = (1.0 / units for units in ipnm)
    change, joint, motor = lost(ipnm), limits.joint_torque, limits.motor_torque
    return Bounds(
        (
            min(joint[0] - change[0], N1 * (motor[0] - e1)) - SLACK,
            joint[1] - change[1] - SLACK,
            joint[2] - change[2] - SLACK,
            min(joint[3] - change[3], N4 * (motor[3] - e4)) - SLACK,
        ),
        (
            limits.torque_rate[0] * T_s - change[0] - SLACK,
            limits.torque_rate[1] * T_s - change[1] - SLACK,
            limits.torque_rate[2] * T_s - change[2] - SLACK,
            limits.torque_rate[3] * T_s - change[3] - SLACK,
        ),
        motor[1] - e2 - SLACK,
        motor[2] - e3 - SLACK,
    )


def clamp(wanted: Vector4, last_sent: Vector4, within: Bounds) -> tuple[Vector4, Clamp]:
    """The torques to send instead of those wanted.

    Args:
        wanted: Joint torques [N m]; if one is not finite, all are taken as zero, never as those sent last.
        last_sent: Joint torques really sent last, after rounding to units [N m].
        within: What `bounds` returned.

    Returns:
        Torques [N m] that the checker accepts after rounding, and which limits acted.
    """
    finite = all(map(isfinite, wanted))
    w1, w2, w3, w4 = wanted if finite else (0.0, 0.0, 0.0, 0.0)
    most1, most2, most3, most4 = within.torque
    step1, step2, step3, step4 = within.step
    last1, last2, last3, last4 = last_sent
    m1, m2 = min(max(w1, -most1), most1), min(max(w2, -most2), most2)
    m3, m4 = min(max(w3, -most3), most3), min(max(w4, -most4), most4)
    t1, t2 = min(max(m1, last1 - step1), last1 + step1), min(max(m2, last2 - step2), last2 + step2)
    t3, t4 = min(max(m3, last3 - step3), last3 + step3), min(max(m4, last4 - step4), last4 + step4)
    share = _share(t2, t3, within)
    if finite and share >= 1.0 and t1 == w1 and t2 == w2 and t3 == w3 and t4 == w4:
        return wanted, NOTHING
    magnitude, rate = (m1, m2, m3, m4) != (w1, w2, w3, w4), (t1, t2, t3, t4) != (m1, m2, m3, m4)
    if share < 1.0:
        t2, t3 = _towards(share * t2, share * t3, last2, last3, within)
    return (t1, t2, t3, t4), Clamp(not finite, magnitude, rate, share < 1.0)


def _share(t2: float, t3: float, within: Bounds) -> float:
    """Largest factor up to 1 that motors 2 and 3 can bear on the torques of joints 2 and 3."""
    by2, by3 = t2 / (2.0 * N2), t3 / (2.0 * N3)
    needs2, needs3 = abs(by2 - by3), abs(by2 + by3)
    share = 1.0
    if needs2 > within.motor2:
        share = within.motor2 / needs2
    if needs3 * share > within.motor3:
        share = within.motor3 / needs3
    return share


def _towards(t2: float, t3: float, last2: float, last3: float, within: Bounds) -> tuple[float, float]:
    """Torques of joints 2 and 3 that the motors can bear, as near as the rate allows from those sent last."""
    _, most2, most3, _ = within.torque
    _, step2, step3, _ = within.step
    shrink = min(_share(last2, last3, within), most2 / max(abs(last2), most2), most3 / max(abs(last3), most3))
    start2, start3 = shrink * last2, shrink * last3
    go2 = min(max(t2, last2 - step2), last2 + step2) - start2
    go3 = min(max(t3, last3 - step3), last3 + step3) - start3
    part2 = go2 / (t2 - start2) if t2 != start2 else 1.0
    part3 = go3 / (t3 - start3) if t3 != start3 else 1.0
    part = min(part2, part3)
    return start2 + part * (t2 - start2), start3 + part * (t3 - start3)
