"""What of `jaxmpc.law` is recorded for an arm: a function for each part of its tick."""

from typing import Any, NamedTuple

from deploy.runtime.flat import flat, nested
from deploy.runtime.straightline import OPS
from jaxmpc.law import chain, entry, force_control, identification, measurement, reference
from jaxmpc.law.computed_torque import JointTorque
from jaxmpc.law.force_control import Command, Controller, ControllerState
from jaxmpc.law.measurement import MeasurementState
from jaxmpc.law.scalar import scale
from jaxmpc.law.vectors import Vector4

_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)


class Memory(NamedTuple):
    """What of a `ControllerState` changes in contact alone; the functions take it and give it as `flat` numbers."""

    axes: Any
    guard: Any
    momentum: Any
    pulse: Any


def memory_of(state: ControllerState) -> Memory:
    """What of a state changes in contact alone."""
    return Memory(state.axes, state.guard, state.momentum, state.pulse)


class ArmLaw:
    """The functions of the tick, closed over a controller's constants."""

    lower_and_response = ((), (0.0,), (0.0,) * 2, (0.0,) * 3), ((0.0,) * 4,) * 3
    """How much of a `JointTorque` tells a torque from a command; `flat` in what the functions take and give."""

    def __init__(self, controller: Controller, preview: bool) -> None:
        self.controller, self.preview = controller, preview
        self.resting = memory_of(force_control.init(controller, _FOUR, _FOUR[:3]))

    def measure(self, measured: Any, q: Any) -> Any:
        """Filtered velocities from the last ones and measured angles."""
        return measurement.measure(self.controller.measurement, measured, q)

    def control(
        self,
        memory: Any,
        bristles: Any,
        applied: Any,
        change: Any,
        q: Any,
        qd: Any,
        force: Any,
        force_ref: Any,
    ) -> Any:
        """A sample of contact: what is remembered, commands, torques, and what tells a torque from a command."""
        state = force_control.holding(self._state(memory, bristles, q, qd), applied, change)
        wanted = force_ref if self.preview else tuple((axis,) for axis in force_ref)
        present, ahead = reference.split(wanted, len(self.controller.gains.mpc_ref))
        state, command = force_control.respond(self.controller, state, force, ahead, OPS, present=present)
        found = command.torque
        return (
            flat(memory_of(state)),
            state.bristles,
            command.v,
            command.a,
            found.torque,
            flat((found.lower, found.response)),
        )

    def _state(self, memory: Any, bristles: Any = None, q: Any = _FOUR, qd: Any = _FOUR) -> ControllerState:
        held: Memory = nested(self.resting, memory)
        measured = MeasurementState(q, qd)
        return ControllerState(measured, held.axes, bristles, held.guard, held.momentum, held.pulse)

    def told(self, v: Any, wanted: Any, found: Any, torque: Any) -> Any:
        """Commands and their change, as torques that were really sent tell them."""
        lower, response = nested(self.lower_and_response, found)
        return force_control.told(Command(JointTorque(wanted, lower, response), v, ()), torque)

    def predict(self, memory: Any) -> Any:
        """Force that is expected to be measured next."""
        return entry.expected_force(self.controller, self._state(memory), OPS)

    def dither(self, memory: Any) -> Any:
        """Sine that was added to the wanted force; 0 without a schedule."""
        schedule, tissues = self.controller.gains.schedule, [axis.tissue for axis in self._state(memory).axes]
        if schedule is None:
            return _FOUR[:3]
        return tuple(identification.dither(schedule.identification, each) for each in tissues if each is not None)

    def enter(self, measured: Any, force: Any, a: Any) -> Any:
        """Memory of the law where contact is made, and its commands there."""
        resting = force_control.init(self.controller, _FOUR, force)
        state = entry.enter(self.controller, resting._replace(measured=measured), force, a, OPS)
        return flat(memory_of(state)), tuple(axis.v for axis in state.axes)

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
