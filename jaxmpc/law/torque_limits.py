"""Joint torques within the robot's limits: magnitude, change in one sample, and the motors that joints 2 and 3 share.

What `deploy.safety.clamp` does on the robot, without what that draws its bounds in by for the rounding to whole puck
units. Joints 2 and 3 must stay where |τ₂/(2 N₂) ∓ τ₃/(2 N₃)| is below the limits of motors 2 and 3; outside, both are
scaled down together, which keeps their direction. Where the limit of the change forbids that, they go towards the
scaled torque from the last one, as far as it allows.
"""

from typing import NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector
from jaxmpc.law.transmission import N1, N2, N3, N4


class TorqueLimits(NamedTuple):
    """What the torques may not pass; each scalar may be a batch, and infinite where there is no limit."""

    torque: Vector
    """Largest torque of each joint, 4 scalars [N m]."""
    step: Vector
    """Largest change of it from one sample to the next, 4 scalars [N m]."""
    motor: Vector
    """Largest torque of each motor, 4 scalars [N m]."""


def limit(limits: TorqueLimits, wanted: Vector, last: Vector, ops: Ops) -> tuple[Vector, Scalar]:
    """Joint torques that the limits let pass.

    Args:
        limits: Constants.
        wanted: Joint torques, 4 scalars [N m].
        last: Those that were sent at the last sample, 4 scalars [N m].
        ops: Scalar functions.

    Returns:
        Torques [N m], the wanted ones bit by bit where no limit acts, and 1 where one acted, else 0. In the tangent
        the torques are the wanted ones, so that a tuner sees the loop through its saturation.
    """
    most1, most2, most3, most4 = limits.torque
    most = (
        ops.minimum(most1, N1 * limits.motor[0]),
        most2,
        most3,
        ops.minimum(most4, N4 * limits.motor[3]),
    )
    held = tuple(ops.clip(value, -high, high) for value, high in zip(wanted, most, strict=True))
    t1, t2, t3, t4 = (
        ops.clip(value, before - step, before + step)
        for value, before, step in zip(held, last, limits.step, strict=True)
    )
    share = _share(limits, t2, t3, ops)
    s2, s3 = _towards(limits, share * t2, share * t3, last, ops)
    over = share < 1.0
    within = (t1, ops.where(over, s2, t2), ops.where(over, s3, t3), t4)
    apart = sum((abs(value - new) for value, new in zip(wanted, within, strict=True)), start=0.0)
    # Held to exactly the torques found, whose tangent is left to the wanted ones.
    passed = tuple(ops.replaced(value, new) for value, new in zip(wanted, within, strict=True))
    return passed, ops.where(apart > 0.0, 1.0, 0.0)


def _share(limits: TorqueLimits, t2: Scalar, t3: Scalar, ops: Ops) -> Scalar:
    """Largest factor up to 1 that motors 2 and 3 can bear on the torques of joints 2 and 3."""
    by2, by3 = t2 / (2.0 * N2), t3 / (2.0 * N3)
    return ops.minimum(_factor(abs(by2 - by3), limits.motor[1], ops), _factor(abs(by2 + by3), limits.motor[2], ops))


def _factor(size: Scalar, most: Scalar, ops: Ops) -> Scalar:
    """What brings a size down to the most that it may be, 1 if it is below."""
    return ops.where(size > most, most, 1.0) / ops.where(size > most, size, 1.0)


def _towards(limits: TorqueLimits, t2: Scalar, t3: Scalar, last: Vector, ops: Ops) -> tuple[Scalar, Scalar]:
    """As far as the change allows from the last torques to those of joints 2 and 3 that the motors can bear."""
    (_, most2, most3, _), (_, step2, step3, _), (_, last2, last3, _) = limits.torque, limits.step, last
    shrink = ops.minimum(_factor(abs(last2), most2, ops), _factor(abs(last3), most3, ops))
    shrink = ops.minimum(_share(limits, last2, last3, ops), shrink)
    start2, start3 = shrink * last2, shrink * last3
    part = ops.minimum(_part(start2, t2, last2, step2, ops), _part(start3, t3, last3, step3, ops))
    return start2 + part * (t2 - start2), start3 + part * (t3 - start3)


def _part(start: Scalar, end: Scalar, last: Scalar, step: Scalar, ops: Ops) -> Scalar:
    """How far the way from start to end stays within a step of the last torque [-]."""
    way, allowed = end - start, ops.clip(end, last - step, last + step) - start
    moves = abs(way) > 0.0
    return ops.where(moves, allowed, 1.0) / ops.where(moves, way, 1.0)
