"""Limits as far as the pucks follow: a puck cuts torque at its own cap (MT) and tells nobody.

What is cut there acts neither on the arm as the law asked nor in what the observers are told, so it is cut here, before
the frame, or the run is refused. A motor is asked for no more than its own limit and what its joints' limits leave it:

    |τ₁|/N₁,   |τ₂|/(2 N₂) + |τ₃|/(2 N₃) for motors 2 and 3,   |τ₄|/N₄
"""

from collections.abc import Sequence
from dataclasses import replace

from deploy.controller.least_rate import CAPPED
from deploy.controller.limits import Limits
from deploy.errors import CalibrationError
from jaxmpc.law.transmission import N1, N2, N3, N4


def within_caps(limits: Limits, caps: Sequence[float]) -> tuple[Limits, str]:
    """Limits that no puck cuts below, and a sentence where they are less than the controller's, else an empty one.

    Args:
        limits: Of the controller.
        caps: Torques at which motors 1–4 are cut, MT over IPNM (4,) [N m].

    Raises:
        CalibrationError: A motor gives much less than the controller counts on.
    """
    t1, t2, t3, t4 = limits.joint_torque
    shared = t2 / (2.0 * N2) + t3 / (2.0 * N3)
    motors, said = list(limits.motor_torque), []
    for i, (cap, by_joints) in enumerate(zip(caps, (t1 / N1, shared, shared, t4 / N4), strict=True)):
        needed = min(motors[i], by_joints)
        if cap >= needed:
            continue
        if cap < CAPPED * needed:
            text = f"the puck of motor {i + 1} cuts its torque at {cap:.3g} N m, below the {needed:.3g} that the"
            remedy = f"set its MT with btutil, or freeze with --limits, limits.motor_torque[{i}] {cap:.3g} at most"
            raise CalibrationError(f"{text} controller counts on: {remedy}")
        motors[i] = cap
        said.append(f"motor {i + 1} at {cap:.3g} instead of {needed:.3g} N m")
    if not said:
        return limits, ""
    m1, m2, m3, m4 = motors
    return replace(limits, motor_torque=(m1, m2, m3, m4)), f"torque is limited as the pucks' MT says: {', '.join(said)}"
