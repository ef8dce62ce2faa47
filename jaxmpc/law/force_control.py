"""The whole controller at one sample: velocities, force filter, three cascades, damping, computed torque.

    q̇ from q,  vₖ per axis from the cascade,  a = v − K₂ ẋ,  τ from a by computed torque      [P] Fig. 1

and, if wanted, what a nominal model says of the joints' friction on top of τ. After `step` the limits may change the
torques; `applied` tells the observers, at every sample, which torques they let pass, before anything rounds them.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxmpc.law import cascade, computed_torque, friction_compensation, gain_backoff, measurement
from jaxmpc.law.cascade import AxisState, Gains
from jaxmpc.law.chain import Chain
from jaxmpc.law.computed_torque import JointTorque, Nominal
from jaxmpc.law.friction_compensation import Bristles
from jaxmpc.law.gain_backoff import BackoffState
from jaxmpc.law.measurement import Measurement, MeasurementState
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, add, scale, sub

NO_FRICTION = (0.0, 0.0, 0.0, 0.0)


class Controller(NamedTuple):
    """Constants of one controller and of the arm that it is for; each scalar may be a batch."""

    chain: Chain
    """The arm."""
    nominal: Nominal
    """How the controller's model differs from it."""
    posture: Vector
    """Joint angles of the null space, 4 scalars [rad]."""
    gains: Gains
    """Gains of the cascades, the same on each axis."""
    K2: Scalar
    """Damping [1/s]."""
    measurement: Measurement
    """How velocities come from angles."""


class ControllerState(NamedTuple):
    """What the controller remembers between two samples."""

    measured: MeasurementState
    """Joint angles and velocities."""
    axes: tuple[AxisState, AxisState, AxisState]
    """Cascades of X, Y, Z."""
    bristles: Bristles | None
    """Deflections of the friction that is cancelled; None cancels none."""
    guard: BackoffState | None = None
    """State of the gain back-off; None where the gain is never taken back."""


class Command(NamedTuple):
    """What the controller wants at one sample."""

    torque: JointTorque
    """Joint torques, with what it takes to judge a change of them."""
    v: Vector
    """Commands of the cascades, X, Y, Z [m/s²]."""
    a: Vector
    """Accelerations asked of the tip, v − K₂ẋ [m/s²]."""


def init(controller: Controller, angle: Vector, force: Vector, compensated: bool = False) -> ControllerState:
    """State at rest in contact.

    Args:
        controller: Constants.
        angle: Measured joint angles, 4 scalars [rad].
        force: Measured force, 3 scalars [N].
        compensated: Whether friction is cancelled.
    """
    x, y, z = (cascade.init(controller.gains, each) for each in force)
    guard = None if controller.gains.guard is None else gain_backoff.init(0.0 * force[0])
    bristles = friction_compensation.init(angle) if compensated else None
    return ControllerState(measurement.init(angle), (x, y, z), bristles, guard)


def step(
    controller: Controller,
    state: ControllerState,
    q: Vector,
    force: Vector,
    force_ref: Sequence[Sequence[Scalar]],
    ops: Ops,
) -> tuple[ControllerState, Command]:
    """Advance the controller by one sample.

    Args:
        controller: Constants.
        state: What `init`, the last `step` or `applied` returned.
        q: Joint angles that the encoders read, 4 scalars [rad].
        force: Measured force on the tissue, 3 scalars [N]; a lost one is bridged by `entry.expected_force`.
        force_ref: Wanted force per axis, as `cascade.step` takes it [N].
        ops: Scalar functions.
    """
    measured = measurement.measure(controller.measurement, state.measured, q)
    return respond(controller, state._replace(measured=measured), force, force_ref, ops)


def respond(
    controller: Controller, state: ControllerState, force: Vector, force_ref: Sequence[Sequence[Scalar]], ops: Ops
) -> tuple[ControllerState, Command]:
    """Advance the controller by one sample whose joint angles and velocities are in the state; else as `step`."""
    gains, guard, (q, qd) = controller.gains, state.guard, state.measured
    filtered = [cascade.filter_force(gains, *axis) for axis in zip(state.axes, force, strict=True)]
    force = tuple(each for _, each in filtered)
    if gains.guard is not None and guard is not None:
        guard = gain_backoff.step(gains.guard, guard, sub(force, tuple(wanted[0] for wanted in force_ref)))
        gains = cascade.with_gain(gains, guard.gain)
    stepped = [cascade.respond(gains, *axis, wanted) for axis, wanted in zip(filtered, force_ref, strict=True)]
    v = tuple(command for _, command in stepped)
    a = sub(v, scale(controller.K2, computed_torque.tip_velocity(controller.chain, q, qd, ops)))
    bristles, torque = torque_for(controller, state, a, force, ops)
    x, y, z = (following for following, _ in stepped)
    return ControllerState(state.measured, (x, y, z), bristles, guard), Command(torque, v, a)


def torque_for(
    controller: Controller, state: ControllerState, a: Vector, force: Vector, ops: Ops
) -> tuple[Bristles | None, JointTorque]:
    """Joint torques for an acceleration of the tip a [m/s²] under a force [N], and the friction's next state."""
    bristles, friction, (q, qd) = state.bristles, NO_FRICTION, state.measured
    if bristles is not None:
        bristles, friction = friction_compensation.step(controller.nominal.friction, bristles, q, qd, ops)
    chain, nominal, posture = controller.chain, controller.nominal, controller.posture
    return bristles, computed_torque.torque(chain, nominal, posture, q, qd, a, force, friction, ops)


def told(command: Command, passed: Vector) -> Vector:
    """Commands that the observers are to take for applied, X, Y, Z [m/s²]: v where the limits changed nothing.

    Args:
        command: What `step` wanted.
        passed: The joint torques that the limits let pass, 4 scalars [N m].
    """
    lost = computed_torque.acceleration_of(command.torque, sub(passed, command.torque.torque))
    return add(command.v, lost)


def holding(state: ControllerState, v: Vector) -> ControllerState:
    """The state whose observers take commands v for applied [m/s²]."""
    x, y, z = (axis._replace(v=each) for axis, each in zip(state.axes, v, strict=True))
    return state._replace(axes=(x, y, z))


def applied(state: ControllerState, command: Command, passed: Vector) -> ControllerState:
    """Tell the observers what was really applied (anti-windup); as `told` and `holding`."""
    return holding(state, told(command, passed))
