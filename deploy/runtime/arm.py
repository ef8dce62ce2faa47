"""The whole tick on the arm: measured angles and force in, joint torques out, as straight-line functions.

    start ─► per sample: velocity ─► servo                      free, approaching, retracting
                     enter ─► velocity ─► control ─► applied    in contact

Everything is `jaxmpc.law`, recorded with the artifact's constants. Like `deploy.runtime.linear` this limits nothing and
judges nothing: the safety layer keeps the arm away from singularities and from values that are not finite, at which
Python's own arithmetic would raise.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.runtime.straightline import compile_straightline
from deploy.runtime.straightline import functions as ops
from jaxmpc.files.errors import InputError
from jaxmpc.law import cascade, chain, computed_torque, force_control, friction_compensation, gain_backoff
from jaxmpc.law.scalar import add, scale, sub
from jaxmpc.law.vectors import Vector3, Vector4
from jaxmpc.world import drive

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact

_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)
_THREE: Vector3 = (0.0, 0.0, 0.0)


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

    def __init__(self, artifact: "Artifact") -> None:
        """Record the tick.

        Args:
            artifact: Of the kind "wam".

        Raises:
            InputError: It is of the kind "linear".
        """
        arm = artifact.arm
        if arm is None:
            remedy = "Freeze it with an experiment on the arm, such as table-1-wam."
            raise InputError("kind", artifact.kind, "wam: a linear controller only replays", remedy)
        self._order, self._compensated, self._posture = cascade.order(artifact.gains), arm.compensated, arm.posture
        self._guarded = artifact.gains.guard is not None
        ahead = _THREE if not artifact.preview else ((0.0,) * len(artifact.gains.mpc_ref),) * 3
        law = _Law(artifact)
        self.start(arm.posture)
        torque, wrench = (self._axes, _THREE, self._bristles, self._guard), (_FOUR, _FOUR, _THREE)
        control = compile_straightline(law.control, (*torque, *wrench, ahead))
        self.operations = control.operations
        self._control = control.function
        self._measure = compile_straightline(law.measure, (self._measured, _FOUR)).function
        self._predict = compile_straightline(law.predict, (self._axes, self._guard)).function
        self._told = compile_straightline(law.told, (_THREE, _FOUR, law.jacobian, law.factors, _FOUR)).function
        self._servo = compile_straightline(law.servo, (self._bristles, *wrench, _THREE)).function
        self._enter = compile_straightline(law.enter, (_THREE, _FOUR, _FOUR, _THREE)).function
        self.gravity = compile_straightline(law.gravity, (_FOUR,)).function
        self.tip = compile_straightline(law.tip, (_FOUR,)).function

    def start(self, q: Vector4) -> None:
        """Forget everything; at rest at measured joint angles [rad], without contact."""
        angles = tuple(map(float, q))  # numbers of numpy would stay and make every sample slower
        self._measured: Any = (angles, _FOUR)
        self._bristles: Any = friction_compensation.init(angles) if self._compensated else ()
        self._guard: Any = gain_backoff.init() if self._guarded else ()
        self._axes: Any = (cascade.init(0.0, self._order),) * 3
        self._applied = self.last_v = self.last_a = self.last_force = _THREE
        self.last_torque = _FOUR
        self._found: Any = None

    def velocity(self, q: Vector4) -> Vector4:
        """Filtered joint velocities [rad/s] from measured angles [rad]; once a sample."""
        self._measured = self._measure(self._measured, q)
        return self._measured[1]  # type: ignore[no-any-return]  # a cast would cost time in the loop

    def enter(self, force: Vector3, q: Vector4) -> None:
        """Contact is made: observers at the measured force [N], full gain, and bumpless.

        What was asked of the tip so far, v = a + K₂ẋ, was all that held it where it is: it is taken for the
        disturbance, p̂ = −v. While the wanted force is the measured one, `control` then begins with the same a.
        """
        self._axes, self._applied, self._guard = self._enter(force, q, self._measured[1], self.last_a)
        self.last_v = self._applied

    def control(self, q: Vector4, qd: Vector4, force: Vector3 | None, force_ref: Any) -> Vector4:
        """Advance the controller by one sample.

        Args:
            q: Measured joint angles [rad].
            qd: What `velocity` gave [rad/s].
            force: Measured force on the tissue [N]; None, for a lost one, is bridged by what the observers predict.
            force_ref: Wanted force of each axis [N]; with preview 1…H samples ahead (3, H).

        Returns:
            Joint torques before any limit [N m]; tell `applied` where they were changed.
        """
        if force is None:
            force = self._predict(self._axes, self._guard)
        self.last_force = force
        self._axes, self._bristles, self._guard, v, self.last_a, self.last_torque, self._found = self._control(
            self._axes, self._applied, self._bristles, self._guard, q, qd, force, force_ref
        )
        self.last_v = self._applied = v
        return self.last_torque

    def applied(self, torque: Vector4) -> None:
        """Tell the observers which joint torques [N m] the limits let pass since the last `control`."""
        if torque != self.last_torque:
            self._applied = self._told(self.last_v, self.last_torque, *self._found, torque)

    def servo(self, q: Vector4, qd: Vector4, acceleration: Vector3, force: Vector3) -> Vector4:
        """Joint torques [N m] for an acceleration of the tip [m/s²] under a measured force [N]; the cascades rest."""
        self.last_a, self.last_force = acceleration, force
        self._bristles, torque = self._servo(self._bristles, q, qd, acceleration, force)
        return torque  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def prediction(self) -> Vector3:
        """What the observers expect to be measured next [N]."""
        return self._predict(self._axes, self._guard)  # type: ignore[no-any-return]  # a cast would cost time in the loop

    @property
    def p_hat(self) -> Vector3:
        """Active states: estimated disturbances [m/s²]."""
        x, y, z = self._axes
        return x[1], y[1], z[1]

    @property
    def u(self) -> Vector3:
        """Outputs of the MPC [N]."""
        x, y, z = self._axes
        return x[2], y[2], z[2]

    @property
    def gain(self) -> float:
        """Share of the loop's gain that the guard leaves [-]; 1 without one."""
        return float(self._guard[0]) if self._guard else 1.0

    @gain.setter
    def gain(self, gain: float) -> None:
        """Only for a replay that does not know how it came about; nothing changes without a guard."""
        self._guard = (gain, *self._guard[1:]) if self._guard else ()


class _Law:
    """The functions to record, closed over an artifact's constants."""

    jacobian = ((0.0,) * 4,) * 3
    factors = (((), (0.0,), (0.0,) * 2, (0.0,) * 3), (0.0,) * 4)

    def __init__(self, artifact: "Artifact") -> None:
        assert artifact.arm is not None
        self.arm, self.K2, self.T_s, self.preview = artifact.arm, artifact.K2, artifact.T_s, artifact.preview
        self.gains = artifact.gains if artifact.preview else cascade.constant_reference(artifact.gains)
        self.pole = drive.pole(self.arm.velocity_cutoff, self.T_s)

    def measure(self, state: Any, q: Any) -> Any:
        """`drives.measure` for angles that the encoders have already rounded."""
        angle, velocity = state
        raw = scale(1.0 / self.T_s, sub(q, angle))
        return q, tuple(new + self.pole * (old - new) for new, old in zip(raw, velocity, strict=True))

    def control(
        self, axes: Any, told: Any, bristles: Any, guard: Any, q: Any, qd: Any, force: Any, force_ref: Any
    ) -> Any:
        arm = self.arm
        state = force_control.ControllerState(
            tuple(axis._replace(v=v) for axis, v in zip(axes, told, strict=True)), bristles or None, guard or None
        )
        wanted = force_ref if self.preview else tuple((axis,) for axis in force_ref)
        state, command = force_control.step(
            arm.chain, arm.nominal, arm.posture, self.gains, self.K2, state, q, qd, force, wanted, ops
        )
        found = command.torque
        held = state.bristles or (), state.guard or ()
        return state.axes, *held, command.v, command.a, found.torque, (found.jacobian, found.factors)

    def told(self, v: Any, wanted: Any, jacobian: Any, factors: Any, torque: Any) -> Any:
        found = computed_torque.JointTorque(wanted, jacobian, factors)
        return add(v, computed_torque.acceleration_of(found, sub(torque, wanted)))

    def predict(self, axes: Any, guard: Any) -> Any:
        # Without a correction, an estimate is a prediction.
        blind = self.gains._replace(K=(0.0,) * len(self.gains.K))
        if guard:
            blind = cascade.with_gain(blind, guard.gain)
        return tuple(cascade.estimate(blind, axis, 0.0)[0][0] for axis in axes)

    def enter(self, force: Any, q: Any, qd: Any, a: Any) -> Any:
        v = add(a, scale(self.K2, computed_torque.tip_velocity(self.arm.chain, q, qd, ops)))
        axes = [cascade.init(each, cascade.order(self.gains)) for each in force]
        guard = gain_backoff.init() if self.gains.guard is not None else ()
        return tuple(axis._replace(p_hat=-held, v=held) for axis, held in zip(axes, v, strict=True)), v, guard

    def servo(self, bristles: Any, q: Any, qd: Any, a: Any, force: Any) -> Any:
        arm, friction = self.arm, force_control.NO_FRICTION
        if bristles:
            bristles, friction = friction_compensation.step(arm.nominal.friction, bristles, q, qd, ops)
        found = computed_torque.torque(arm.chain, arm.nominal, arm.posture, q, qd, a, force, friction, ops)
        return bristles, found.torque

    def gravity(self, q: Any) -> Any:
        """Torques that hold the arm in the controller's model [N m]."""
        share = self.arm.nominal.mass_scale
        believed = chain.with_point_mass(self.arm.chain, self.arm.nominal.tool_error / share)
        return scale(share, chain.inverse_dynamics(believed, chain.pose(believed, q, ops), _FOUR, _FOUR))

    def tip(self, q: Any) -> Any:
        """Position of the tip in the shoulder's frame [m]."""
        return chain.tip(self.arm.chain, chain.pose(self.arm.chain, q, ops)).position


def replay(artifact: "Artifact") -> tuple[float, float]:
    """Largest deviations from the golden trace: of v, relative to its largest [-], and of the torques [N m].

    As in `deploy.runtime.linear.replay` no feedback amplifies rounding: the trace gives the torques that were
    applied too.
    """
    runtime, arm = ArmRuntime(artifact), artifact.arm
    assert arm is not None
    inputs = zip(
        *(each.tolist() for each in (arm.golden_q, artifact.golden_force, artifact.golden_force_ref)), strict=True
    )
    v, torques = [], []
    runtime.start(tuple(arm.golden_q[0].tolist()))
    runtime.enter(tuple(artifact.golden_force[0].tolist()), tuple(arm.golden_q[0].tolist()))
    for (q, force, force_ref), told in zip(inputs, arm.golden_applied.tolist(), strict=True):
        torques.append(runtime.control(q, runtime.velocity(q), force, force_ref))
        v.append(runtime.last_v)
        runtime.applied(told)
    largest = float(np.max(np.abs(artifact.golden_v)))
    torque = float(np.max(np.abs(np.array(torques) - arm.golden_torque)))
    return float(np.max(np.abs(np.array(v) - artifact.golden_v))) / largest, torque
