"""The whole tick on the arm: measured angles and force in, joint torques out, as straight-line functions.

    start ─► per sample: velocity ─► servo                      free, approaching, retracting
                     enter ─► velocity ─► control ─► applied    in contact

Everything is `jaxmpc.law`, recorded with one controller's constants. Like `deploy.runtime.linear` this limits nothing
and judges nothing: the safety layer keeps the arm away from singularities and from values that are not finite, at
which Python's own arithmetic would raise.
"""

import math
from operator import itemgetter
from typing import Any

from deploy.runtime.arm_law import ArmLaw, Memory, memory_of
from deploy.runtime.flat import flat, places
from deploy.runtime.force_lag import lag
from deploy.runtime.straightline import compile_straightline
from jaxmpc.law import force_control
from jaxmpc.law.force_control import Controller
from jaxmpc.law.friction_compensation import Bristles
from jaxmpc.law.vectors import Vector3, Vector4

_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)
_THREE: Vector3 = (0.0, 0.0, 0.0)


class ArmRuntime:
    """The controller of one arm.

    Attributes:
        operations: Arithmetic operations of `control`.
        places: Of each number in `remembered`.
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
        self.places: Memory = places(law.resting)
        self._read(self.places)
        wanted = ((0.0,) * (1 + len(controller.gains.mpc_ref)),) * 3 if preview else _THREE
        memory, seen = self._memory, (_FOUR, _FOUR)
        control = compile_straightline(law.control, (memory, self._bristles, _THREE, _FOUR, *seen, _THREE, wanted))
        self.operations = control.operations
        self._control = control.function
        self._measure = compile_straightline(law.measure, (self._measured, _FOUR)).function
        self._predict = compile_straightline(law.predict, (memory,)).function
        self._dither = compile_straightline(law.dither, (memory,)).function
        self._told = compile_straightline(law.told, (_THREE, _FOUR, flat(law.lower_and_response), _FOUR)).function
        self._servo = compile_straightline(law.servo, (self._bristles, *seen, _THREE, _THREE)).function
        self._enter = compile_straightline(law.enter, (self._measured, _THREE, _THREE)).function
        self.gravity = compile_straightline(law.gravity, (_FOUR,)).function
        self.tip = compile_straightline(law.tip, (_FOUR,)).function

    def start(self, q: Vector4) -> None:
        """Forget everything; at rest at measured joint angles [rad], without contact."""
        angles = tuple(map(float, q))  # numbers of numpy would stay and make every sample slower
        state = force_control.init(self._controller, angles, _THREE, self._compensated)
        self._measured, self._bristles, self._held = state.measured, state.bristles, [flat(memory_of(state))]
        self._applied = self.last_v = self.last_a = self.last_force = _THREE
        self._change = self.last_torque = _FOUR
        self._found: Any = None

    def _read(self, where: Any) -> None:
        """How parts of the memory are read out of it, each at its places there."""
        tissues = [axis.tissue for axis in where.axes if axis.tissue is not None]

        def of_each(parts: Any, name: str) -> Any:
            return itemgetter(*(getattr(part, name) for part in parts)) if parts else lambda memory: _THREE

        self._p_hat, self._u = of_each(where.axes, "p_hat"), of_each(where.axes, "u")
        self._believed, self._authority = of_each(tissues, "log_stiffness"), of_each(tissues, "authority")
        self._sines = [itemgetter(*flat((t.listening, t.heard, t.force[-1], t.tip[-1]))) for t in tissues]
        self._share = None if where.guard is None else where.guard.share
        self._backed_off = None if where.guard is None else slice(where.guard.memory[0], where.guard.memory[-1] + 1)

    def velocity(self, q: Vector4) -> Vector4:
        """Filtered joint velocities [rad/s] from measured angles [rad]; once a sample."""
        self._measured = self._measure(self._measured, q)
        return self._measured[1]

    def enter(self, force: Vector3, q: Vector4, qd: Vector4 | None = None) -> None:
        """Contact is made: observers at the measured force, full gain, and bumpless.

        While the wanted force is the measured one, `control` begins with the same a that was asked for so far.

        Args:
            force: Measured force on the tissue [N].
            q: Measured joint angles [rad].
            qd: Joint velocities [rad/s]; None for what `velocity` gave last.
        """
        self._held[0], self._applied = self._enter((q, qd or self._measured[1]), force, self.last_a)
        self.last_v, self._change = self._applied, _FOUR

    def control(self, q: Vector4, qd: Vector4, force: Vector3 | None, force_ref: Any) -> Vector4:
        """Advance the controller by one sample.

        Args:
            q: Measured joint angles [rad].
            qd: What `velocity` gave [rad/s].
            force: Measured force on the tissue [N]; None, for a lost one, is bridged by what is expected.
            force_ref: Wanted force of each axis [N]; with preview of this sample and of 1…H ahead (3, 1 + H).

        Returns:
            Joint torques before any limit [N m]; tell `applied` what the limits let pass.

        Raises:
            ValueError: A number is missing, or one too many; all is forgotten, as by `start`.
        """
        if force is None:
            force = self._predict(self._memory)
        self.last_force = force
        try:
            # Handed over for good: what Python need not keep it uses again at once, which is 3 µs of a family's tick.
            memory, self._bristles, self.last_v, self.last_a, self.last_torque, self._found = self._control(
                self._held.pop(), self._bristles, self._applied, self._change, q, qd, force, force_ref
            )
        except BaseException:
            self.start(self._measured[0])
            raise
        self._held.append(memory)
        self._applied = self.last_v
        self._change = _FOUR
        return self.last_torque

    def applied(self, torque: Vector4) -> None:
        """Tell the observers which joint torques [N m] the limits let pass since the last `control`."""
        if torque != self.last_torque:  # else it would find v again
            self._applied, self._change = self._told(self.last_v, self.last_torque, self._found, torque)

    def servo(self, q: Vector4, qd: Vector4, acceleration: Vector3, force: Vector3) -> Vector4:
        """Joint torques [N m] for an acceleration of the tip [m/s²] under a measured force [N]; the cascades rest."""
        self.last_a, self.last_force = acceleration, force
        self._bristles, torque = self._servo(self._bristles, q, qd, acceleration, force)
        return torque  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def _memory(self) -> Any:
        return self._held[0]

    @property
    def prediction(self) -> Vector3:
        """Force that is expected to be measured next [N]."""
        return self._predict(self._memory)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def p_hat(self) -> Vector3:
        """Active states: estimated disturbances [m/s²]."""
        return self._p_hat(self._memory)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def u(self) -> Vector3:
        """Outputs of the MPC [N]."""
        return self._u(self._memory)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def stiffness(self) -> Vector3:
        """K̂, what the tissue's stiffness is believed to be along each axis [N/m]; 0 without a schedule."""
        if not self._sines:
            return _THREE
        x, y, z = map(math.exp, self._believed(self._memory))
        return x, y, z

    @property
    def remembered(self) -> tuple[float, ...]:
        """All that changes in contact alone, each number at its place."""
        return self._memory  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @remembered.setter
    def remembered(self, memory: tuple[float, ...]) -> None:
        """Only for a check."""
        self._held[0] = memory

    @property
    def authority(self) -> Vector3:
        """Share of the control that the schedule has [-]; 0 without one."""
        return self._authority(self._memory)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def dither(self) -> Vector3:
        """Sine that was added to the wanted force [N]; 0 without a schedule."""
        return self._dither(self._memory)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def lag(self) -> Vector3:
        """By how long the measured force comes after the displacement [s]; 0 where no sine tells it."""
        schedule = self._controller.gains.schedule
        if schedule is None:
            return _THREE
        x, y, z = (lag(schedule.identification, *sine(self._memory)) for sine in self._sines)
        return x, y, z

    @property
    def deflection(self) -> Vector4:
        """Deflection of the bristles of the friction that is cancelled, over its largest [-]; 0 where none is."""
        return _FOUR if self._bristles is None else self._bristles[0]

    @deflection.setter
    def deflection(self, deflection: Vector4) -> None:
        """Only for a replay, at the last measured angles; nothing changes where no friction is cancelled."""
        if self._compensated:
            self._bristles = Bristles(deflection, self._measured[0])

    @property
    def gain(self) -> float:
        """Share of the loop's gain that the guard leaves [-]; 1 without one."""
        return self.memory[0]

    @property
    def memory(self) -> Vector3:
        """That share, its ceiling, and where it was lately [-]; ones without a guard."""
        return (1.0, 1.0, 1.0) if self._backed_off is None else self._memory[self._backed_off]

    @memory.setter
    def memory(self, memory: Vector3) -> None:
        """Only for a replay that does not know how it came about; nothing changes without a guard."""
        if self._backed_off is not None:
            before, after = self._memory[: self._backed_off.start], self._memory[self._backed_off.stop :]
            self._held[0] = (*before, *memory, *after)

    @property
    def swing_share(self) -> float:
        """Share of the force's error that a guard takes for a lasting swing [-]; 0 without one."""
        return 0.0 if self._share is None else self._memory[self._share]

    @swing_share.setter
    def swing_share(self, share: float) -> None:
        """As `memory`."""
        if self._share is not None:
            self._held[0] = (*self._memory[: self._share], share, *self._memory[self._share + 1 :])
