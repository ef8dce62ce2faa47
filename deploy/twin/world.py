"""The arm and the heart of the twin: C MuJoCo for the links, the simulator's own friction, tissue and heart.

A millisecond is `substeps` semi-implicit Euler steps h, each as `jaxmpc.world.robot` makes it with "euler":

    (M + h D) q̈ = τ − f(q̇) − Jᵀ y(d, ḋ) − c − D q̇,  q̇' = q̇ + h q̈,  q' = q + h q̇'

with friction f, force y on the tissue and the deflection d = x_tip − x_heart at the beginning of the step. An idle puck
shorts its motor through the windings, viscous friction of Kt²/R at the motor: with it the arm sinks, it is not held.
Until the first torque acts, somebody holds the arm.
"""

from collections import deque
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from deploy.twin.compiled import friction_step, joint_torques
from deploy.twin.contact import TwinContact
from deploy.twin.force_sensor_model import ForceSensorModel
from deploy.twin.heart import TwinHeart
from deploy.twin.settings import HOME, TwinSettings
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.transmission import JOINT_TO_MOTOR
from jaxmpc.law.vectors import Vector3, Vector4
from jaxmpc.world import friction
from jaxmpc.world.arm import mjcf, tip_at

TICK = 1e-3
"""[s]"""
WINDING, TORQUE_CONSTANT = 3.473, 0.457
"""Resistance and torque constant of the motors [Ω] and [N m/A] (Barrett's wiki)."""
STOP_STIFFNESS = 3000.0
"""Stiffness of the rubber at the joints' ends [N m/rad] (chosen here)."""


class Truth(NamedTuple):
    """True state of arm and heart, which no controller can know."""

    time: float
    """[s]"""
    q: Vector4
    """Joint angles [rad]."""
    qd: Vector4
    """[rad/s]"""
    tip: Vector3
    """Position of the tip in the shoulder frame [m]."""
    tip_velocity: Vector3
    """[m/s]"""
    heart: Vector3
    """Displacement of the heart's surface [m]."""
    force: Vector3
    """Force on the tissue [N]."""
    measured: Vector3
    """The same behind sensor and noise [N]."""
    torque: Vector4
    """Joint torque of the motors in the last millisecond [N m]."""
    touching: bool


class TwinPhysics:
    """Physics of arm, heart and contact."""

    def __init__(self, settings: TwinSettings) -> None:
        import mujoco

        self._settings, self._mujoco = settings, mujoco
        self._model = _model(settings)
        self._data = mujoco.MjData(self._model)
        self._site = self._model.site("tip").id
        self._jacobian = np.zeros((3, self._model.nv))
        self._h = TICK / settings.substeps
        self._model.opt.timestep = self._h
        self._at = self._data.site_xpos[self._site]
        self._braked: tuple[bool, ...] = ()
        self._coupling, self._coupled = np.zeros((4, 4)), False
        self._low, self._high = (tuple(row) for row in self._model.jnt_range.T.tolist())
        self._rub = friction_step(friction.Friction(settings.coulomb, settings.presliding), self._h)
        self._heart = TwinHeart(settings.motion, self._h)
        self._contact = TwinContact(settings, _three(tip_at(settings.posture)))
        self.posture = _raised(settings.posture, settings.gap)
        """Joint angles above the heart [rad]."""
        self._force_sensor = ForceSensorModel(settings)
        self._instant = 0
        self._acting: Vector4 = (0.0, 0.0, 0.0, 0.0)
        self._pending = deque([self._acting] * settings.delay)
        self._held = True
        self.place(HOME if settings.cold else self.posture)
        self._contact.begin(settings.gap == 0.0 and not settings.cold)
        self._sense()

    @property
    def q(self) -> Vector4:
        """Joint angles [rad]."""
        return self._q

    @property
    def measured(self) -> Vector3:
        """Force on the tissue as the force sensor reads it, in the world's axes [N]."""
        return self._measured

    @property
    def orientation(self) -> np.ndarray:
        """Rotation from the tool's axes to the world's, shape (3, 3)."""
        turned: np.ndarray = self._data.site_xmat[self._site].reshape(3, 3)
        return turned

    def place(self, q: Vector4, seconds: float = 0.0) -> None:
        """Somebody carries the arm to joint angles [rad], in some seconds, and holds it until the next torque acts."""
        self._held = True
        self._way = [_between(self._q, q, k * TICK / seconds) for k in range(round(seconds / TICK), 0, -1)]
        if not self._way:
            self._hold(q)

    def _hold(self, q: Vector4) -> None:
        self._data.qpos[:], self._data.qvel[:] = q, 0.0
        self._bristles = friction.init(0.0)
        self._contact.begin(False)
        self._settle()

    def advance(self, motor: Vector4, braked: tuple[bool, ...]) -> None:
        """Advance by one millisecond.

        Args:
            motor: Torque of each motor commanded before now; it acts `delay` milliseconds later [N m].
            braked: Which motors are shorted, whatever the torque.
        """
        self._pending.append(motor)
        acting = self._pending.popleft()
        driven = tuple(0.0 if short else tau for tau, short in zip(acting, braked, strict=True))
        self._acting = joint_torques(driven)
        self._held = self._held and not any(driven)
        if braked != self._braked:
            self._brake(braked)
        if self._held and self._way:
            self._hold(self._way.pop())
        for _ in range(self._settings.substeps):
            self._substep()
        self._sense()

    def truth(self) -> Truth:
        """The state at this moment."""
        state = self._instant * self._h, self._q, self._qd, self._tip, self._speed, self._surface
        return Truth(*state, self._force, self._measured, self._acting, self._contact.touching)

    def _brake(self, braked: tuple[bool, ...]) -> None:
        """Friction of shorted motors at the joints, Tᵀ diag(Kt²/R) T; one of motors 2 and 3 alone couples J2 and J3."""
        T: np.ndarray = np.array(JOINT_TO_MOTOR)
        friction = TORQUE_CONSTANT**2 / WINDING * T.T @ np.diag(np.array(braked, float)) @ T
        self._braked, self._coupling = braked, friction - np.diag(np.diag(friction))
        self._coupled = bool(self._coupling.any())
        self._model.dof_damping[:] = self._settings.viscous + np.diag(friction)

    def _substep(self) -> None:
        data = self._data
        force = self._press(self._h)
        if not self._held:
            self._bristles, rubbing = self._rub(self._bristles, self._qd)
            stops = map(_stop, self._q, self._low, self._high)
            driven = [tau - f + s for tau, f, s in zip(self._acting, rubbing, stops, strict=True)]
            data.qfrc_applied[:] = driven - np.array(force) @ self._jacobian
            if self._coupled:
                data.qfrc_applied[:] -= self._coupling @ data.qvel
            self._mujoco.mj_step2(self._model, data)
        self._instant += 1
        if self._held:
            self._beat()
        else:
            self._settle()

    def _settle(self) -> None:
        """Update what follows from the present angles and velocities and from the heart."""
        self._mujoco.mj_step1(self._model, self._data)
        self._mujoco.mj_jacSite(self._model, self._data, self._jacobian, None, self._site)
        self._q, self._qd = _four(self._data.qpos), _four(self._data.qvel)
        self._tip, self._speed = _three(self._at), _three(self._jacobian @ self._data.qvel)
        self._beat()

    def _beat(self) -> None:
        self._surface, self._rate = self._heart.at(self._instant)

    def _press(self, h: float) -> Vector3:
        now = self._tip, self._speed, self._surface, self._rate, self._instant * self._h
        return self._contact.press(*now, h)

    def _sense(self) -> None:
        self._force = self._press(0.0)
        self._measured = self._force_sensor.read(self._force, self._speed)


def _model(settings: TwinSettings) -> Any:
    """The arm of the MJCF alone: the heart is a force, and shapes are for the eye."""
    import mujoco

    spec = mujoco.MjSpec.from_string(mjcf())
    spec.delete(spec.body("heart"))
    for geom in list(spec.geoms):
        spec.delete(geom)
    compiled = spec.compile()
    tool = compiled.body("tool").id
    compiled.body_mass[1:] *= settings.mass_scale
    compiled.body_inertia[1:] *= settings.mass_scale
    compiled.body_mass[tool] = settings.tool_mass
    mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
    return compiled


@cache  # flights of one controller begin alike
def _raised(posture: Vector4, gap: float) -> Vector4:
    """The nearest joint angles with the tip so much higher [rad], by Gauss and Newton."""
    from jaxmpc.law.chain import pose, tip
    from jaxmpc.world.arm import chain

    q, wanted = np.array(posture), tip_at(posture) + np.array([0.0, 0.0, gap])
    for _ in range(20 if gap else 0):
        found = tip(chain(), pose(chain(), tuple(q.tolist()), FLOATS))
        q = q + np.linalg.pinv(np.array(found.jacobian)) @ (wanted - found.position)
    return _four(q)


def _between(begin: Vector4, end: Vector4, share: float) -> Vector4:
    """A point of a smooth way from one posture to another."""
    s = share * share * (3.0 - 2.0 * share)
    a, b, c, d = ((1.0 - s) * x + s * y for x, y in zip(begin, end, strict=True))
    return a, b, c, d


def _stop(angle: float, low: float, high: float) -> float:
    """Torque of the joint's mechanical stop [N m]."""
    return STOP_STIFFNESS * (low - angle if angle < low else high - angle if angle > high else 0.0)


def _three(values: Any) -> Vector3:
    a, b, c = values.tolist()
    return a, b, c


def _four(values: Any) -> Vector4:
    a, b, c, d = values.tolist()
    return a, b, c, d
