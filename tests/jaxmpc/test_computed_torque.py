"""Torques from an acceleration of the tip, against MuJoCo's forward dynamics and the formula in numpy."""

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from jaxmpc.law import computed_torque, friction_compensation
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.world.arm import chain, model

CHAIN = chain()
NONE = (0.0, 0.0, 0.0, 0.0)
FRICTIONLESS = NominalFriction(NONE, NONE, 1e-3)
EXACT = Nominal(1.0, 0.0, FRICTIONLESS)
POSTURE = np.array([0.0, 0.7, 0.0, 2.2])
CLOSE = {"rtol": 0, "atol": 1e-9}
"""[m/s²], [N m]: some 1e3 roundings of 1e-16 on figures up to 1e3."""


def cases(count=20):
    """Near the posture, where the arm is far from singular: q, q̇, a, y."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        yield POSTURE + rng.normal(0.0, 0.2, 4), rng.normal(0.0, 1.0, 4), rng.normal(0.0, 5.0, 3), rng.normal(0, 5.0, 3)


class Mujoco:
    """The arm as C MuJoCo sees it at one state."""

    def __init__(self, q, qd):
        self.model = model()
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:4], self.data.qvel[:4] = q, qd
        self.qd = qd
        mujoco.mj_forward(self.model, self.data)
        J, Jdot, M = np.zeros((3, 7)), np.zeros((3, 7)), np.zeros((7, 7))
        site = self.model.site("tip")
        mujoco.mj_jacSite(self.model, self.data, J, None, site.id)
        mujoco.mj_jacDot(self.model, self.data, Jdot, None, self.data.site_xpos[site.id], int(site.bodyid[0]))
        mujoco.mj_fullM(self.model, self.data, M)
        self.J, self.drift, self.M = J[:, :4].copy(), Jdot[:, :4] @ qd, M[:4, :4].copy()
        self.bias = self.data.qfrc_bias[:4].copy()

    def accelerate(self, torque, force):
        """Joint accelerations, the tissue pushing back with −y and the joints' viscous friction made up for."""
        self.data.qfrc_applied[:4] = torque - self.J.T @ force + self.model.dof_damping[:4] * self.qd
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc[:4].copy()

    def tip(self, qdd):
        return self.J @ qdd + self.drift


def torque(nominal, q, qd, a, y, friction=NONE):
    flat = (tuple(np.asarray(x).tolist()) for x in (POSTURE, q, qd, a, y))
    return computed_torque.torque(CHAIN, nominal, *flat, friction, math)


def test_an_exact_model_accelerates_the_tip_as_asked():
    """By MuJoCo's forward dynamics, with the tissue's force on the tip; its feed-forward is +Jᵀy."""
    for q, qd, a, y in cases():
        world = Mujoco(q, qd)
        qdd = world.accelerate(np.array(torque(EXACT, q, qd, a, y).torque), y)
        np.testing.assert_allclose(world.tip(qdd), a, **CLOSE)
        unaware = world.accelerate(np.array(torque(EXACT, q, qd, a, np.zeros(3)).torque), y)
        push = world.J @ np.linalg.solve(world.M, world.J.T @ y)
        np.testing.assert_allclose(world.tip(unaware), a - push, **CLOSE)


def test_the_posture_is_held_where_the_tip_does_not_feel_it():
    """What remains of q̈ beside the tip's is the posture's acceleration, in the null space and inertia weighted."""
    for q, qd, a, y in cases():
        world = Mujoco(q, qd)
        qdd = world.accelerate(np.array(torque(EXACT, q, qd, a, y).torque), y)
        held = -20.0 * (q - POSTURE) - 9.0 * qd
        M_inv = np.linalg.inv(world.M)
        J_bar = M_inv @ world.J.T @ np.linalg.inv(world.J @ M_inv @ world.J.T)
        np.testing.assert_allclose(qdd, J_bar @ (a - world.drift) + (np.eye(4) - J_bar @ world.J) @ held, **CLOSE)
        np.testing.assert_allclose(world.J @ (np.eye(4) - J_bar @ world.J) @ held, 0.0, **CLOSE)


@pytest.mark.parametrize(("scale", "extra"), [(0.9, 0.0), (1.1, 0.2), (0.85, -0.1)])
def test_a_wrong_model_gives_the_torque_of_its_own_masses(scale, extra):
    """M̂ and ĉ in numpy: links and tool scaled, drives exact, a mass at the tip that is not there."""
    for q, qd, a, y in cases(5):
        world = Mujoco(q, qd)
        drives = np.diag(world.model.dof_armature[:4])
        J, M = world.J, scale * (world.M - np.diag(world.model.dof_armature[:4])) + drives
        M = M + extra * J.T @ J
        bias = scale * world.bias + extra * J.T @ (world.drift - world.model.opt.gravity)
        held = -20.0 * (q - POSTURE) - 9.0 * qd
        felt = np.linalg.inv(J @ np.linalg.inv(M) @ J.T)
        wanted = M @ held + J.T @ (felt @ (a - world.drift - J @ held) + y) + bias
        found = torque(Nominal(scale, extra, FRICTIONLESS), q, qd, a, y)
        np.testing.assert_allclose(found.torque, wanted, **CLOSE)


def test_friction_torque_comes_on_top():
    friction = (2.0, -1.0, 0.5, -0.25)
    for q, qd, a, y in cases(5):
        more, plain = torque(EXACT, q, qd, a, y, friction).torque, torque(EXACT, q, qd, a, y).torque
        np.testing.assert_allclose(np.subtract(more, plain), friction, **CLOSE)


def test_known_friction_is_cancelled():
    """Against Dahl's equation by scipy at angles that turn back and forth; a step slides 5 % of z at most."""
    believed, T_s = NominalFriction((2.0, 1.0, 0.5, 0.25), (1.5, 0.9, 0.5, 0.2), 1e-3), 2e-4
    t = np.arange(0.0, 1.0, T_s)
    angle = 0.02 * np.sin(2 * np.pi * t) + 0.004 * np.sin(2 * np.pi * 5.3 * t)
    speed = np.gradient(angle, T_s)
    state, found = friction_compensation.init((0.0,) * 4), []
    for q, v in zip(angle.tolist(), speed.tolist(), strict=True):
        state, torques = friction_compensation.step(believed, state, (q,) * 4, (v,) * 4, math)
        found.append(torques)
    slope = CubicSpline(t, angle).derivative()
    dahl = solve_ivp(
        lambda t, s: (slope(t) - abs(slope(t)) * s) / 1e-3, (0.0, t[-1]), [0.0], t_eval=t, max_step=1e-3, rtol=1e-8
    ).y[0]
    wanted = np.outer(dahl, believed.coulomb) + np.outer(speed, believed.viscous)
    assert np.abs(dahl).max() > 0.99
    np.testing.assert_allclose(found, wanted, atol=0.05 * 2.0, rtol=0)


def test_what_a_clamp_takes_from_the_tip():
    """The observer's v is corrected by J M⁻¹ Δτ: by MuJoCo's forward dynamics what the tip really loses."""
    for q, qd, a, y in cases(5):
        world, found = Mujoco(q, qd), torque(EXACT, q, qd, a, y)
        change = np.array([3.0, -2.0, 0.5, 1.0])
        lost = computed_torque.acceleration_of(found, tuple(change.tolist()))
        really = world.tip(world.accelerate(np.array(found.torque) + change, y)) - a
        np.testing.assert_allclose(lost, really, **CLOSE)


def test_tip_velocity_is_the_jacobians():
    for q, qd, *_ in cases(5):
        np.testing.assert_allclose(
            computed_torque.tip_velocity(CHAIN, tuple(q), tuple(qd), math), Mujoco(q, qd).J @ qd, **CLOSE
        )
