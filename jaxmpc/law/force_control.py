"""The whole controller at one sample: three cascades, damping, computed torque.

vₖ per axis from the cascade,  a = v − K₂ ẋ,  τ from a by computed torque      [P] Fig. 1
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxmpc.law import cascade, computed_torque
from jaxmpc.law.cascade import ControllerState, Gains
from jaxmpc.law.chain import Chain
from jaxmpc.law.computed_torque import Nominal, Torque
from jaxmpc.law.scalar import Scalar, Vector, add, scale, sub

Axes = tuple[ControllerState, ControllerState, ControllerState]


class Command(NamedTuple):
    """What the controller wants at one sample."""

    torque: Torque
    """Joint torques, with what it takes to judge a change of them."""
    v: Vector
    """Commands of the cascades, X, Y, Z [m/s²]."""
    a: Vector
    """Accelerations asked of the tip, v − K₂ẋ [m/s²]."""


def init(force: Scalar = 0.0) -> Axes:
    """Three cascades at rest at a measured force [N]."""
    state = cascade.init(force)
    return state, state, state


def step(
    chain: Chain,
    nominal: Nominal,
    posture: Vector,
    gains: Gains,
    K2: Scalar,
    state: Axes,
    q: Vector,
    qd: Vector,
    force: Vector,
    force_ref: Sequence[Sequence[Scalar]],
    ops: Any,
) -> tuple[Axes, Command]:
    """Advance the controller by one sample.

    Args:
        chain: The arm.
        nominal: How it is believed to differ.
        posture: Joint angles of the null space, 4 scalars [rad].
        gains: Of the cascade, the same on each axis.
        K2: Damping [1/s].
        state: What `init` or the last `step` returned.
        q: Measured joint angles, 4 scalars [rad].
        qd: Measured joint velocities, 4 scalars [rad/s].
        force: Measured force on the tissue, 3 scalars [N].
        force_ref: Wanted force per axis, as `cascade.step` takes it [N].
        ops: Scalar functions.
    """
    stepped = [cascade.step(gains, *axis) for axis in zip(state, force, force_ref, strict=True)]
    v = tuple(command for _, command in stepped)
    a = sub(v, scale(K2, computed_torque.tip_velocity(chain, q, qd, ops)))
    found = computed_torque.torque(chain, nominal, posture, q, qd, a, force, ops)
    x, y, z = (following for following, _ in stepped)
    return (x, y, z), Command(found, v, a)


def applied(state: Axes, command: Command, clamped: Vector) -> Axes:
    """Tell the observers what was really applied (anti-windup).

    Args:
        state: That `step` returned.
        command: Its command.
        clamped: The joint torques that the limits let pass, 4 scalars [N m].
    """
    lost = computed_torque.acceleration_of(command.torque, sub(clamped, command.torque.torque))
    told = add(command.v, lost)
    x, y, z = (axis._replace(v=v) for axis, v in zip(state, told, strict=True))
    return x, y, z
