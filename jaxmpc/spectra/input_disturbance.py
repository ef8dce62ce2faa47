"""What friction and model error do to the tip of the arm, as an acceleration that the linear loop can take.

Residual motion is small, so the tip is taken to follow the heart exactly. Then its velocity ẋ alone settles what
the joints do, nearly whatever the controller is. With nominal Mₙ, cₙ as in `law.computed_torque` and n the motion of
the joints that leaves the tip at rest,

    q̇ = J̄ ẋ + n η̇,   J̄ = M⁻¹ Jᵀ Λ                                     (nᵀ M J̄ = 0)
    nᵀM n η̈ = nᵀ (Mₙ q̈₀ + r),   r = τ_f − f(q̇) − D q̇ + cₙ − c           the null space
    a = J q̈₀ + Λₙ⁻¹ (Λ ẍ − J̄ᵀ (Mₙ q̈₀ + r))                             what has to be asked of the arm
    w = ẍ − a                                                          what acts besides, in units of a

with friction f, its compensation τ_f, viscous friction D. As a disturbance at the command, w also holds what a wrong
mass matrix makes of a. Friction drags the elbow through the null space: without η, the Y residual is 10 to 30 % too
large. J, M and n are those of the resting posture; the heart moves the tip by a few per cent of its reach.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.law import friction_compensation
from jaxmpc.law.chain import Chain, dynamics, mass_matrix, pose, tip, with_point_mass
from jaxmpc.law.computed_torque import POSTURE_DAMPING, POSTURE_STIFFNESS
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import sub
from jaxmpc.world import friction
from jaxmpc.world.arm import chain
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.heart.motion import displacement
from jaxmpc.world.robot import Robot

Trajectory = Float[np.ndarray, "steps joints"]


class _Posture(NamedTuple):
    """The arm in its resting posture."""

    M: np.ndarray
    M_n: np.ndarray
    """Mass matrix with armature, true and nominal [kg m²]."""
    J: np.ndarray
    J_bar: np.ndarray
    """M⁻¹ Jᵀ Λ: joint velocities per tip velocity [rad/m]."""
    to_command: np.ndarray
    """Λₙ⁻¹ J̄ᵀ: what a joint torque is worth in commanded acceleration [m/s²/(N m)]."""
    gain: np.ndarray
    """Λ⁻¹ Λₙ: acceleration of the tip per acceleration asked [-]."""
    n: np.ndarray
    """Direction of the null space [-]."""


def uncompensated_acceleration(experiment: Experiment) -> Float[np.ndarray, "steps 3"]:
    """Disturbance acceleration w at the command of each axis while the tip follows the heart [m/s²].

    It comes from the settings of `experiment.arm`, whatever the physics. Left out are the observer of the joints'
    momentum (`arm.momentum_observer`: the friction is then that without it), the cable mode, the rounding of encoders
    and torques, and what the tip's own motion against the heart does to the friction: reversals come out too
    sharp, by a fifth of the residual for a loop with M_s = 4.5.

    Args:
        experiment: Its heart moves, its arm rubs.
    """
    T_s = experiment.sampling_time
    robot = robot_of(experiment)
    truth = with_point_mass(chain(), robot.tool_mass)
    model = with_point_mass(chain(), robot.nominal.tool_error / robot.nominal.mass_scale)
    posture = _posture(truth, model, robot)
    x, velocity = displacement(experiment.motion, np.arange(experiment.steps) * T_s)
    q, qd = x @ posture.J_bar.T, velocity @ posture.J_bar.T

    at = pose(truth, tuple((q + robot.posture).T), ARRAYS)
    bias_error = robot.nominal.mass_scale * _bias(model, at, qd) - _bias(truth, at, qd)
    restoring = -(POSTURE_STIFFNESS * q + POSTURE_DAMPING * qd)
    given = restoring @ posture.M_n + bias_error - qd * robot.viscous
    eta, etad, rubbing = _null_space(posture, robot, q, qd, given @ posture.n)

    slipped = POSTURE_STIFFNESS * eta + POSTURE_DAMPING * etad
    load = given - np.outer(slipped, posture.M_n @ posture.n) - np.outer(etad, posture.n * robot.viscous) - rubbing
    # A single sample tells of no change.
    xdd = np.gradient(velocity, T_s, axis=0) if len(velocity) > 1 else np.zeros_like(velocity)
    asked = restoring @ posture.J.T + xdd @ np.linalg.inv(posture.gain).T - load @ posture.to_command.T
    disturbance: np.ndarray = xdd - asked
    return disturbance


def _posture(truth: Chain, model: Chain, robot: Robot) -> _Posture:
    at = pose(truth, tuple(np.asarray(robot.posture)), ARRAYS)
    J = np.array(tip(truth, at).jacobian, float)
    M = np.array(mass_matrix(truth, at), float) + np.diag(truth.armature)
    M_n = robot.nominal.mass_scale * np.array(mass_matrix(model, at), float) + np.diag(truth.armature)
    mobility = J @ np.linalg.solve(M, J.T)
    nominal_mobility = J @ np.linalg.solve(M_n, J.T)
    J_bar = np.linalg.solve(M, J.T) @ np.linalg.inv(mobility)
    gain = mobility @ np.linalg.inv(nominal_mobility)
    return _Posture(M, M_n, J, J_bar, nominal_mobility @ J_bar.T, gain, np.linalg.svd(J)[2][-1])


def _bias(of: Chain, at: Any, qd: Trajectory) -> Trajectory:
    """Coriolis and gravity torques along a motion [N m]."""
    bias = dynamics(of, at, tuple(qd.T)).bias
    return np.stack(np.broadcast_arrays(*bias, qd[:, 0])[:4], axis=1)


def _null_space(
    posture: _Posture, robot: Robot, q: Trajectory, qd: Trajectory, given: Float[np.ndarray, " steps"]
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"], Trajectory]:
    """η [rad], η̇ [rad/s] and friction less its compensation [N m], step by step.

    Args:
        posture: The arm.
        robot: Its friction and what is compensated of it.
        q: Joint angles that follow the heart, from the resting posture [rad].
        qd: Their velocities [rad/s].
        given: All of nᵀ(Mₙ q̈₀ + r) that neither η nor the friction makes.
    """
    (T_s, pole), nominal = robot.measurement, robot.nominal.friction
    # Python's own numbers: numpy takes longer than a microsecond for each vector of four.
    n = n_1, n_2, n_3, n_4 = posture.n.tolist()
    inertia = float(posture.n @ posture.M @ posture.n)
    held = float(posture.n @ posture.M_n @ posture.n)
    damping = POSTURE_DAMPING * held + float(posture.n**2 @ np.asarray(robot.viscous))
    bristles = friction.init()
    cancelled = seen = (0.0,) * 4
    compensator = friction_compensation.init(cancelled) if any(nominal.coulomb) or any(nominal.viscous) else None
    eta = etad = 0.0
    found, rubbing = [], []
    for angles, row, pull in zip(q.tolist(), qd.tolist(), given.tolist(), strict=True):
        found.append((eta, etad))
        moving = [v + share * etad for v, share in zip(row, n, strict=True)]
        bristles, f = friction.step(robot.friction, bristles, moving, T_s, FLOATS)
        if compensator is not None:
            f = sub(f, cancelled)
            seen = tuple(v + pole * (old - v) for v, old in zip(moving, seen, strict=True))
            turned = tuple(angle + share * eta for angle, share in zip(angles, n, strict=True))
            compensator, cancelled = friction_compensation.step(nominal, compensator, turned, seen, FLOATS)
        rubbing.append(f)
        dragged = n_1 * f[0] + n_2 * f[1] + n_3 * f[2] + n_4 * f[3]
        etad += T_s * (pull - dragged - POSTURE_STIFFNESS * held * eta - damping * etad) / inertia
        eta += T_s * etad
    return *np.array(found).T, np.array(rubbing)
