"""The whole controller at one sample: three cascades, damping, computed torque.

vₖ per axis from the cascade,  a = v − K₂ ẋ,  τ from a by computed torque      [P] Fig. 1

and, if wanted, what a nominal model says of the joints' friction on top of τ.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxmpc.law import cascade, computed_torque, friction_compensation, gain_backoff
from jaxmpc.law.cascade import AxisState, Gains
from jaxmpc.law.chain import Chain
from jaxmpc.law.computed_torque import JointTorque, Nominal
from jaxmpc.law.friction_compensation import Bristles
from jaxmpc.law.scalar import Scalar, Vector, add, scale, sub

NO_FRICTION = (0.0, 0.0, 0.0, 0.0)


class ControllerState(NamedTuple):
    """What the controller remembers between two samples."""

    axes: tuple[AxisState, AxisState, AxisState]
    """Cascades of X, Y, Z."""
    bristles: Bristles | None
    """Deflections of the friction that is cancelled; None cancels none."""
    guard: gain_backoff.BackoffState | None = None
    """State of the gain back-off; None where the gain is never taken back."""


class Command(NamedTuple):
    """What the controller wants at one sample."""

    torque: JointTorque
    """Joint torques, with what it takes to judge a change of them."""
    v: Vector
    """Commands of the cascades, X, Y, Z [m/s²]."""
    a: Vector
    """Accelerations asked of the tip, v − K₂ẋ [m/s²]."""


def init(force: Scalar = 0.0, order: int = 1, angle: Vector | None = None, guarded: bool = False) -> ControllerState:
    """At rest.

    Args:
        force: Measured force on each axis [N].
        order: Disturbance order of the cascades.
        angle: Measured joint angles, 4 scalars [rad]; None cancels no friction.
        guarded: Whether the gain is taken back while the force swings.
    """
    axis = cascade.init(force, order)
    guard = gain_backoff.init(0.0 * force) if guarded else None
    return ControllerState((axis, axis, axis), None if angle is None else friction_compensation.init(angle), guard)


def step(
    chain: Chain,
    nominal: Nominal,
    posture: Vector,
    gains: Gains,
    K2: Scalar,
    state: ControllerState,
    q: Vector,
    qd: Vector,
    force: Vector,
    force_ref: Sequence[Sequence[Scalar]],
    ops: Any,
) -> tuple[ControllerState, Command]:
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
    guard = state.guard
    if gains.guard is not None and guard is not None:
        guard = gain_backoff.step(gains.guard, guard, sub(force, tuple(wanted[0] for wanted in force_ref)))
        gains = cascade.with_gain(gains, guard.gain)
    stepped = [cascade.step(gains, *axis) for axis in zip(state.axes, force, force_ref, strict=True)]
    v = tuple(command for _, command in stepped)
    a = sub(v, scale(K2, computed_torque.tip_velocity(chain, q, qd, ops)))
    bristles, friction = state.bristles, NO_FRICTION
    if bristles is not None:
        bristles, friction = friction_compensation.step(nominal.friction, bristles, q, qd, ops)
    found = computed_torque.torque(chain, nominal, posture, q, qd, a, force, friction, ops)
    x, y, z = (following for following, _ in stepped)
    return ControllerState((x, y, z), bristles, guard), Command(found, v, a)


def applied(state: ControllerState, command: Command, clamped: Vector) -> ControllerState:
    """Tell the observers what was really applied (anti-windup).

    Args:
        state: That `step` returned.
        command: Its command.
        clamped: The joint torques that the limits let pass, 4 scalars [N m].
    """
    lost = computed_torque.acceleration_of(command.torque, sub(clamped, command.torque.torque))
    told = add(command.v, lost)
    x, y, z = (axis._replace(v=v) for axis, v in zip(state.axes, told, strict=True))
    return state._replace(axes=(x, y, z))
