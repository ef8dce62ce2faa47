"""The whole controller at one sample: velocities, force filter, three cascades, damping, computed torque.

    q̇ from q,  vₖ per axis from the cascade,  a = v − K₂ ẋ,  τ from a by computed torque      [P] Fig. 1

and, if wanted, what a nominal model says of the joints' friction on top of τ, or what an observer of their momentum
takes for a disturbance. After `step` the limits may change the torques; `applied` tells the observers and the guard, at
every sample, which torques they let pass, before anything rounds them.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxmpc.law import (
    cascade,
    chain,
    computed_torque,
    friction_compensation,
    gain_backoff,
    measurement,
    momentum_observer,
    pulse,
    repetition,
    schedule,
)
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.chain import Chain
from jaxmpc.law.computed_torque import JointTorque, Nominal
from jaxmpc.law.friction_compensation import Bristles
from jaxmpc.law.gain_backoff import BackoffState
from jaxmpc.law.gains import Gains, backed_off
from jaxmpc.law.measurement import Measurement, MeasurementState
from jaxmpc.law.momentum_observer import MomentumState
from jaxmpc.law.ops import Ops
from jaxmpc.law.pulse import Pulse
from jaxmpc.law.scalar import ZERO, Scalar, Vector, add, apply, dot, plus, sub, times

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
    momentum_bandwidth: Scalar | None = None
    """With which a disturbance of the joints' momentum is observed and cancelled [rad/s]; None observes none."""


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
    momentum: MomentumState | None = None
    """State of the observer of the joints' momentum; None where nothing is observed."""
    pulse: Pulse | None = None
    """What is known of the heart's rate; None where no beat is learned."""


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
    measured = measurement.init(angle)
    momentum = None if controller.momentum_bandwidth is None else momentum_observer.init(measured.velocity)
    learning = schedule.repetition_of(controller.gains)
    heart = None if learning is None else pulse.init(learning.finder, force[0])
    return ControllerState(measured, (x, y, z), bristles, guard, momentum, heart)


def step(
    controller: Controller,
    state: ControllerState,
    q: Vector,
    force: Vector,
    force_ref: Sequence[Sequence[Scalar]],
    ops: Ops,
    push: Vector = ZERO,
    present: Vector | None = None,
) -> tuple[ControllerState, Command]:
    """Advance the controller by one sample.

    Args:
        controller: Constants.
        state: What `init`, the last `step` or `applied` returned.
        q: Joint angles that the encoders read, 4 scalars [rad].
        force: Measured force on the tissue, 3 scalars [N]; a lost one is bridged by `entry.expected_force`.
        force_ref: Wanted force per axis, as `cascade.step` takes it [N].
        ops: Scalar functions.
        push: Acceleration added to a that the cascades do not know of, where a loop is to be judged, 3 scalars [m/s²].
        present: Wanted force of the sample itself where `force_ref` is of later ones, 3 scalars; None where that is its
            first [N].
    """
    measured = measurement.measure(controller.measurement, state.measured, q)
    return respond(controller, state._replace(measured=measured), force, force_ref, ops, push, present)


def respond(
    controller: Controller,
    state: ControllerState,
    force: Vector,
    force_ref: Sequence[Sequence[Scalar]],
    ops: Ops,
    push: Vector = ZERO,
    present: Vector | None = None,
) -> tuple[ControllerState, Command]:
    """Advance the controller by one sample whose joint angles and velocities are in the state; else as `step`."""
    gains, guard, (q, qd) = controller.gains, state.guard, state.measured
    tip = chain.tip(controller.chain, chain.pose(controller.chain, q, ops))
    taken = 0.0 if guard is None else gain_backoff.taken(guard.memory, ops)
    anywhere = schedule.alarm(state.axes, ops)
    # A force is judged by what is wanted now, not by what is wanted when the command acts.
    wanted = tuple(ahead[0] for ahead in force_ref) if present is None else present
    heard = [
        schedule.listen(gains, axis, y, x, now, taken, anywhere, ops)
        for axis, y, x, now in zip(state.axes, force, tip.position, wanted, strict=True)
    ]
    listening, dithers, answers = zip(*heard, strict=True)
    filtered = [cascade.filter_force(gains, axis, y) for axis, y in zip(listening, force, strict=True)]
    force, speed = tuple(each for _, each in filtered), apply(tip.jacobian, qd)
    error = sub(sub(force, answers), wanted)
    if gains.guard is not None and guard is not None:
        guard = gain_backoff.step(gains.guard, guard, error, ops, (*dithers, *answers))
    heart, learned, added = _repeated(gains, state.pulse, [axis for axis, _ in filtered], error, speed, ops)
    axes, v, damping = [], [], []
    for axis, y, besides, ahead, xdot in zip(learned, force, add(dithers, added), force_ref, speed, strict=True):
        known, K2 = schedule.now(gains, controller.K2, axis, ops)
        if guard is not None:
            known = backed_off(known, guard.memory.gain, ops)
            K2 = K2 * gain_backoff.damping(guard.memory, ops)
        following, command = cascade.respond(known, axis, y, tuple(plus(each, besides) for each in ahead))
        damping.append(times(K2, xdot))
        axes.append(following)
        v.append(command)
    a = sub(tuple(v), tuple(damping))
    bristles, torque = torque_for(controller, state, add(a, push), force, ops)
    momentum, torque = _undisturbed(controller, state, torque)
    x, y, z = axes
    after = ControllerState(state.measured, (x, y, z), bristles, guard, momentum, heart)
    return after, Command(torque, tuple(v), a)


def _repeated(
    gains: Gains, known: Pulse | None, axes: Sequence[AxisState], error: Vector, speed: Vector, ops: Ops
) -> tuple[Pulse | None, Sequence[AxisState], Vector]:
    """What is known of the heart's beat, the axes, and what beats before tell to add to their wanted forces [N]."""
    learning = schedule.repetition_of(gains)
    if learning is None or known is None:
        return known, axes, ZERO
    known, heard = pulse.step(learning.finder, known, speed[-1], ops)
    beat = repetition.beat_of(learning, known, ops)
    found = [
        repetition.step(learning, axis.learned, beat, e, heard * axis.tissue.authority, ops)
        for axis, e in zip(axes, error, strict=True)
        if axis.learned is not None and axis.tissue is not None
    ]
    following = [axis._replace(learned=learned) for axis, (learned, _) in zip(axes, found, strict=True)]
    return known, following, tuple(added for _, added in found)


def _undisturbed(
    controller: Controller, state: ControllerState, torque: JointTorque
) -> tuple[MomentumState | None, JointTorque]:
    """Joint torques less the disturbance of the momentum that they show, and the observer's next state."""
    bandwidth, momentum = controller.momentum_bandwidth, state.momentum
    if bandwidth is None or momentum is None:
        return momentum, torque
    wanted = sub(torque.torque, torque.load)
    momentum = momentum_observer.step(
        bandwidth, controller.measurement, momentum, torque.mass, state.measured.velocity, wanted
    )
    return momentum, torque._replace(torque=sub(torque.torque, momentum.residual))


def torque_for(
    controller: Controller, state: ControllerState, a: Vector, force: Vector, ops: Ops
) -> tuple[Bristles | None, JointTorque]:
    """Joint torques for an acceleration of the tip a [m/s²] under a force [N], and the friction's next state."""
    bristles, friction, (q, qd) = state.bristles, NO_FRICTION, state.measured
    if bristles is not None:
        bristles, friction = friction_compensation.step(controller.nominal.friction, bristles, q, qd, ops)
    arm, nominal, posture = controller.chain, controller.nominal, controller.posture
    return bristles, computed_torque.torque(arm, nominal, posture, q, qd, a, force, friction, ops)


def told(command: Command, passed: Vector) -> tuple[Vector, Vector]:
    """What the observers are to take for applied.

    Args:
        command: What `step` wanted.
        passed: The joint torques that the limits let pass, 4 scalars [N m].

    Returns:
        Commands X, Y, Z [m/s²], v where the limits changed nothing, and what they changed of the torques [N m].
    """
    change = sub(passed, command.torque.torque)
    return add(command.v, computed_torque.acceleration_of(command.torque, change)), change


def holding(state: ControllerState, v: Vector, change: Vector) -> ControllerState:
    """The state whose observers and guard take commands v [m/s²] and torques changed by so much [N m] for applied."""
    x, y, z = (axis._replace(v=each) for axis, each in zip(state.axes, v, strict=True))
    guard, momentum = state.guard, state.momentum
    if guard is not None:
        held_back = sub(v, tuple(axis.v for axis in state.axes))
        guard = guard._replace(held_back=dot(held_back, held_back))
    if momentum is not None:
        momentum = momentum._replace(accelerating=add(momentum.accelerating, change))
    return state._replace(axes=(x, y, z), guard=guard, momentum=momentum)


def applied(state: ControllerState, command: Command, passed: Vector) -> ControllerState:
    """Tell observers and guard what was really applied (anti-windup); as `told` and `holding`."""
    return holding(state, *told(command, passed))
