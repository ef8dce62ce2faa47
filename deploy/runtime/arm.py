"""The whole tick on the arm: measured angles and force in, joint torques out, as straight-line functions.

    start ─► per sample: velocity ─► servo                      free, approaching, retracting
                     enter ─► velocity ─► control ─► applied    in contact

Everything is `jaxmpc.law`, recorded with one controller's constants. Like `deploy.runtime.linear` this limits nothing
and judges nothing: the safety layer keeps the arm away from singularities and from values that are not finite, at
which Python's own arithmetic would raise.
"""

import math
from collections.abc import Callable
from typing import Any

from deploy.runtime import force_lag
from deploy.runtime.arm_law import ArmLaw
from deploy.runtime.straightline import compile_straightline
from jaxmpc.law import force_control, identification
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.force_control import Controller
from jaxmpc.law.gain_backoff import BackoffState
from jaxmpc.law.stiffness import StiffnessEstimate, StiffnessIdentification
from jaxmpc.law.vectors import Vector3, Vector4

_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)
_THREE: Vector3 = (0.0, 0.0, 0.0)
_P_HAT, _U, _TISSUE = map(AxisState._fields.index, ("p_hat", "u", "tissue"))
_BELIEVED, _AUTHORITY = map(StiffnessEstimate._fields.index, ("log_stiffness", "authority"))
_MEMORY = BackoffState._fields.index("memory")


class ArmRuntime:
    """The controller of one arm.

    Attributes:
        operations: Arithmetic operations of `control`.
        last_v: Commands of the cascades at the last sample [m/s²].
        last_a: Accelerations last asked of the tip [m/s²].
        last_force: Force that the last `control` worked with, predicted if none was measured [N].
        last_torque: Torques it wanted [N m].
    """

    last_v: Vector3
    last_a: Vector3
    last_force: Vector3
    last_torque: Vector4

    def __init__(self, controller: Controller, compensated: bool, preview: bool) -> None:
        """Record the tick.

        Args:
            controller: Floats; without preview with one weight of the reference.
            compensated: Whether friction is cancelled.
            preview: Whether the wanted force is known ahead, as many samples as the reference has weights.
        """
        law = ArmLaw(controller, preview)
        self._controller, self._compensated = controller, compensated
        self.start(controller.posture)
        ahead = ((0.0,) * len(controller.gains.mpc_ref),) * 3 if preview else _THREE
        memory = self._axes, self._bristles, self._guard, self._momentum, self._heart
        seen = _FOUR, _FOUR
        control = compile_straightline(law.control, (*memory, _THREE, _FOUR, *seen, _THREE, ahead))
        self.operations = control.operations
        self._control = control.function
        self._measure = compile_straightline(law.measure, (self._measured, _FOUR)).function
        self._predict = compile_straightline(law.predict, (self._axes, self._guard)).function
        self._told = compile_straightline(law.told, (_THREE, _FOUR, law.lower, law.response, _FOUR)).function
        self._servo = compile_straightline(law.servo, (self._bristles, *seen, _THREE, _THREE)).function
        self._enter = compile_straightline(law.enter, (self._measured, _THREE, _THREE)).function
        self.gravity = compile_straightline(law.gravity, (_FOUR,)).function
        self.tip = compile_straightline(law.tip, (_FOUR,)).function

    def start(self, q: Vector4) -> None:
        """Forget everything; at rest at measured joint angles [rad], without contact."""
        angles = tuple(map(float, q))  # numbers of numpy would stay and make every sample slower
        self._hold(*force_control.init(self._controller, angles, _THREE, self._compensated))
        self._applied = self.last_v = self.last_a = self.last_force = _THREE
        self._change = self.last_torque = _FOUR
        self._found: Any = None

    def _hold(self, measured: Any, axes: Any, bristles: Any, guard: Any, momentum: Any, heart: Any) -> None:
        """Keep the parts of a `ControllerState`, each of which changes where the others rest."""
        self._measured, self._axes, self._bristles, self._guard = measured, axes, bristles, guard
        self._momentum, self._heart = momentum, heart

    def velocity(self, q: Vector4) -> Vector4:
        """Filtered joint velocities [rad/s] from measured angles [rad]; once a sample."""
        self._measured = self._measure(self._measured, q)
        return self._measured[1]  # type: ignore[no-any-return]  # a cast would cost time in the loop

    def enter(self, force: Vector3, q: Vector4) -> None:
        """Contact is made: observers at the measured force [N] and angles [rad], full gain, and bumpless.

        While the wanted force is the measured one, `control` begins with the same a that was asked for so far.
        """
        entered = self._enter((q, self._measured[1]), force, self.last_a)
        self._axes, self._guard, self._momentum, self._heart, self._applied = entered
        self.last_v, self._change = self._applied, _FOUR

    def control(self, q: Vector4, qd: Vector4, force: Vector3 | None, force_ref: Any) -> Vector4:
        """Advance the controller by one sample.

        Args:
            q: Measured joint angles [rad].
            qd: What `velocity` gave [rad/s].
            force: Measured force on the tissue [N]; None, for a lost one, is bridged by what is expected.
            force_ref: Wanted force of each axis [N]; with preview 1…H samples ahead (3, H).

        Returns:
            Joint torques before any limit [N m]; tell `applied` what the limits let pass.
        """
        if force is None:
            force = self._predict(self._axes, self._guard)
        self.last_force = force
        memory, v, self.last_a, self.last_torque, self._found = self._control(
            self._axes,
            self._bristles,
            self._guard,
            self._momentum,
            self._heart,
            self._applied,
            self._change,
            q,
            qd,
            force,
            force_ref,
        )
        self._axes, self._bristles, self._guard, self._momentum, self._heart = memory
        self.last_v = self._applied = v
        self._change = _FOUR
        return self.last_torque

    def applied(self, torque: Vector4) -> None:
        """Tell the observers which joint torques [N m] the limits let pass since the last `control`."""
        if torque != self.last_torque:  # else it would find v again
            self._applied, self._change = self._told(self.last_v, self.last_torque, *self._found, torque)

    def servo(self, q: Vector4, qd: Vector4, acceleration: Vector3, force: Vector3) -> Vector4:
        """Joint torques [N m] for an acceleration of the tip [m/s²] under a measured force [N]; the cascades rest."""
        self.last_a, self.last_force = acceleration, force
        self._bristles, torque = self._servo(self._bristles, q, qd, acceleration, force)
        return torque  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def prediction(self) -> Vector3:
        """Force that is expected to be measured next [N]."""
        return self._predict(self._axes, self._guard)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def p_hat(self) -> Vector3:
        """Active states: estimated disturbances [m/s²]."""
        x, y, z = self._axes
        return x[_P_HAT], y[_P_HAT], z[_P_HAT]

    @property
    def u(self) -> Vector3:
        """Outputs of the MPC [N]."""
        x, y, z = self._axes
        return x[_U], y[_U], z[_U]

    @property
    def stiffness(self) -> Vector3:
        """K̂, what the tissue's stiffness is believed to be along each axis [N/m]; 0 without a schedule."""
        return self._known(lambda tissue: math.exp(tissue[_BELIEVED]))

    @property
    def authority(self) -> Vector3:
        """Share of the control that the schedule has [-]; 0 without one."""
        return self._known(lambda tissue: tissue[_AUTHORITY])

    @property
    def dither(self) -> Vector3:
        """Sine that was added to the wanted force [N]; 0 without a schedule."""
        return self._told_by_sine(identification.dither)

    @property
    def lag(self) -> Vector3:
        """By how long the measured force comes after the displacement [s]; 0 where no sine tells it."""
        return self._told_by_sine(force_lag.lag)

    def _told_by_sine(self, number: Callable[[StiffnessIdentification, StiffnessEstimate], float]) -> Vector3:
        """A number of each axis' identification."""
        schedule = self._controller.gains.schedule
        if schedule is None:
            return _THREE
        constants = schedule.identification
        return self._known(lambda tissue: number(constants, StiffnessEstimate(*tissue)))

    def _known(self, number: Callable[[Any], float]) -> Vector3:
        """A number of each axis' estimate of its tissue."""
        x, y, z = (axis[_TISSUE] for axis in self._axes)
        return _THREE if x is None else (number(x), number(y), number(z))

    @property
    def gain(self) -> float:
        """Share of the loop's gain that the guard leaves [-]; 1 without one."""
        return self.memory[0]

    @property
    def memory(self) -> Vector3:
        """That share, its ceiling, and where it was lately [-]; ones without a guard."""
        return self._guard[_MEMORY] if self._guard else (1.0, 1.0, 1.0)

    @memory.setter
    def memory(self, memory: Vector3) -> None:
        """Only for a replay that does not know how it came about; nothing changes without a guard."""
        if self._guard:
            self._guard = (*self._guard[:_MEMORY], memory, *self._guard[_MEMORY + 1 :])
