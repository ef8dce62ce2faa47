"""What of `jaxmpc.law` is recorded for an arm: a function for each part of its tick."""

from typing import Any

from deploy.runtime.straightline import OPS
from jaxmpc.law import chain, entry, force_control, measurement
from jaxmpc.law.computed_torque import JointTorque
from jaxmpc.law.force_control import Command, Controller, ControllerState
from jaxmpc.law.measurement import MeasurementState
from jaxmpc.law.scalar import scale
from jaxmpc.law.vectors import Vector4

_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)


class ArmLaw:
    """The functions of the tick, closed over a controller's constants."""

    lower = ((), (0.0,), (0.0,) * 2, (0.0,) * 3)
    response = ((0.0,) * 4,) * 3

    def __init__(self, controller: Controller, preview: bool) -> None:
        self.controller, self.preview = controller, preview

    def measure(self, measured: Any, q: Any) -> Any:
        """Filtered velocities from the last ones and measured angles."""
        return measurement.measure(self.controller.measurement, measured, q)

    def control(
        self,
        axes: Any,
        bristles: Any,
        guard: Any,
        momentum: Any,
        heart: Any,
        applied: Any,
        change: Any,
        q: Any,
        qd: Any,
        force: Any,
        force_ref: Any,
    ) -> Any:
        """A sample of contact: what is remembered, commands, torques, and what tells a torque from a command."""
        state = ControllerState(MeasurementState(q, qd), axes, bristles, guard, momentum, heart)
        state = force_control.holding(state, applied, change)
        wanted = force_ref if self.preview else tuple((axis,) for axis in force_ref)
        state, command = force_control.respond(self.controller, state, force, wanted, OPS)
        found = command.torque
        return state[1:], command.v, command.a, found.torque, (found.lower, found.response)

    def told(self, v: Any, wanted: Any, lower: Any, response: Any, torque: Any) -> Any:
        """Commands and their change, as torques that were really sent tell them."""
        return force_control.told(Command(JointTorque(wanted, lower, response), v, ()), torque)

    def predict(self, axes: Any, guard: Any) -> Any:
        """Force that is expected to be measured next."""
        state = ControllerState(MeasurementState(_FOUR, _FOUR), axes, None, guard)
        return entry.expected_force(self.controller, state, OPS)

    def enter(self, measured: Any, force: Any, a: Any) -> Any:
        """Memory of the law where contact is made."""
        resting = force_control.init(self.controller, _FOUR, force)
        state = entry.enter(self.controller, resting._replace(measured=measured), force, a, OPS)
        return state.axes, state.guard, state.momentum, state.pulse, tuple(axis.v for axis in state.axes)

    def servo(self, bristles: Any, q: Any, qd: Any, a: Any, force: Any) -> Any:
        """Friction's memory, and torques for an acceleration of the tip."""
        state = force_control.init(self.controller, q, force)
        state = state._replace(measured=MeasurementState(q, qd), bristles=bristles)
        bristles, found = force_control.torque_for(self.controller, state, a, force, OPS)
        return bristles, found.torque

    def gravity(self, q: Any) -> Any:
        """Torques that hold the arm in the controller's model [N m]."""
        arm, (share, tool_error, _) = self.controller.chain, self.controller.nominal
        model = chain.with_point_mass(arm, tool_error / share)
        return scale(share, chain.inverse_dynamics(model, chain.pose(model, q, OPS), _FOUR, _FOUR))

    def tip(self, q: Any) -> Any:
        """Position of the tip in the shoulder's frame [m]."""
        arm = self.controller.chain
        return chain.tip(arm, chain.pose(arm, q, OPS)).position
