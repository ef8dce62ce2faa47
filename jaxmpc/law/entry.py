"""How contact is entered, and how a lost force is bridged.

What was asked of the tip before contact, v = a + K₂ẋ, was all that held it where it is: the observers take it for the
disturbance, p̂ = −v. While the wanted force is the measured one, the cascades then begin with the same a: no bump. So
does MPC alone, which has no active state and forgets v within its observer's time (`cascade.going_on`).
"""

from jaxmpc.law import cascade, computed_torque, gain_backoff, momentum_observer, pulse, schedule
from jaxmpc.law.force_control import Controller, ControllerState
from jaxmpc.law.gains import backed_off
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Vector, add, scale


def enter(controller: Controller, state: ControllerState, force: Vector, a: Vector, ops: Ops) -> ControllerState:
    """Begin control in contact: observers at the measured force, full gain, no disturbance, friction as it was.

    Args:
        controller: Constants.
        state: Before contact; its joint angles and velocities are those of the last sample.
        force: Measured, 3 scalars [N].
        a: Acceleration that was asked of the tip so far, 3 scalars [m/s²].
        ops: Scalar functions.
    """
    v = add(a, scale(controller.K2, computed_torque.tip_velocity(controller.chain, *state.measured, ops)))
    x, y, z = (cascade.going_on(controller.gains, felt, held) for felt, held in zip(force, v, strict=True))
    guard = None if controller.gains.guard is None else gain_backoff.init(0.0 * force[0])
    momentum = None if controller.momentum_bandwidth is None else momentum_observer.init(state.measured.velocity)
    learning = schedule.repetition_of(controller.gains)
    heart = None if learning is None else pulse.init(learning.finder, force[0])
    return state._replace(axes=(x, y, z), guard=guard, momentum=momentum, pulse=heart)


def expected_force(controller: Controller, state: ControllerState, ops: Ops) -> Vector:
    """What is to be measured at the next sample, X, Y, Z [N]; it stands in for a force that is lost."""
    expected = []
    for axis in state.axes:
        gains, _ = schedule.now(controller.gains, controller.K2, axis, ops)
        gains = gains if state.guard is None else backed_off(gains, state.guard.memory.gain, ops)
        expected.append(cascade.expected_force(gains, axis))
    return tuple(expected)
