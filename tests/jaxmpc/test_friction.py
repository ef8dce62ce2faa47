"""Dahl friction against solve_ivp, its closed-form hysteresis and central differences."""

import math
from types import SimpleNamespace

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from scipy.integrate import solve_ivp

from jaxmpc.world.friction import PRESLIDING, SMALL_VELOCITY, Friction, init, step

FLOATS = SimpleNamespace(sqrt=math.sqrt)
COULOMB = (2.7, 2.5, 1.5, 1.1)
"""Coulomb friction of a Barrett WAM, openwam's Dynamics.cc: the highest published [N m]."""
NOMINAL = Friction(COULOMB)


def torques(friction, velocity, h):
    """Torques along velocities of shape (steps, 4)."""
    s, found = init(), []
    for v in velocity:
        s, torque = step(friction, s, v, h, FLOATS)
        found.append(torque)
    return np.array(found)


def velocity(t):
    """Reversals, slow and fast, and a stop."""
    return 0.05 * np.sin(2 * np.pi * 0.5 * t) + 0.02 * np.sin(2 * np.pi * 3.1 * t) * (t < 2.5)


def test_against_solve_ivp():
    z = (0.5e-3, 1e-3, 2e-3, 5e-3)
    t = np.arange(0.0, 4.0, 1e-3)

    def rates(t, s):
        v = velocity(t)
        return (v - np.sqrt(v * v + 1e-6) * s) / np.array(z)

    wanted = np.array(COULOMB) * solve_ivp(rates, (0.0, 4.0), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-9).y.T
    errors = []
    for fine in (1, 4):
        h = 1e-3 / fine
        path = np.repeat(velocity((np.arange(len(t) * fine) + 0.5) * h)[:, None], 4, 1)
        # After the k-th step it is the time of the next sample.
        errors.append(np.abs(torques(Friction(COULOMB, z), path, h)[fine - 1 :: fine][:-1] - wanted[1:]).max(axis=0))
    assert (errors[0] < 0.04 * np.array(COULOMB)).all()
    # First order in h.
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.25)


def test_a_reversal_settles_over_the_presliding():
    """s = −1 + 2 exp(−x / z) after a reversal at s = 1, x from there; friction is rate independent."""
    h, v = 1e-4, 0.1
    there, back = np.full((2000, 4), v), np.full((300, 4), -v)
    found = torques(NOMINAL, np.concatenate([there, back]), h) / np.array(COULOMB)
    assert found[1999] == pytest.approx(1.0, abs=1e-4)
    x = v * h * np.arange(1, 301)
    wanted = -1.0 + 2.0 * np.exp(-x / PRESLIDING)
    np.testing.assert_allclose(found[2000:], np.repeat(wanted[:, None], 4, 1), atol=0.01)


def test_near_rest_the_joint_is_a_spring():
    torque = torques(NOMINAL, np.full((1, 4), 1e-3), 1e-3)[0]
    np.testing.assert_allclose(torque, np.array(COULOMB) * 1e-6 / PRESLIDING, rtol=2e-3)


@given(
    s=st.floats(-1.0, 1.0),
    v=st.floats(-1e3, 1e3),
    h=st.floats(1e-6, 1e3),
    z=st.floats(1e-6, 1.0),
)
def test_bounded_and_stable_at_any_step(s, v, h, z):
    after, torque = step(Friction(COULOMB, z), (s,) * 4, (v,) * 4, h, FLOATS)
    assert max(map(abs, after)) <= 1.0 + 1e-15
    assert np.all(np.abs(torque) <= np.array(COULOMB) * (1.0 + 1e-15))


@given(v=st.floats(0.1, 10.0))
def test_sliding_takes_the_coulomb_torque_of_its_own_sign(v):
    for sign in (1.0, -1.0):
        found = torques(NOMINAL, np.full((40, 4), sign * v), 1e-3)[-1]
        np.testing.assert_allclose(found, sign * np.array(COULOMB), rtol=0.03)


def test_gradients_against_central_differences():
    """With respect to constants, deflection and velocity; forward and reverse; at rest too."""

    def outputs(flat, ops):
        after, torque = step(Friction(flat[:4], flat[4:8]), flat[8:12], flat[12:], 1e-3, ops)
        return [*after, *torque]

    points = [(s, v) for s in (-1.0, 0.0, 0.6) for v in (0.0, 1e-9, SMALL_VELOCITY, -0.02, 1.0)]
    inputs = np.array([[*COULOMB, 1e-3, 2e-3, 1e-3, 5e-4, *(s,) * 4, *(v,) * 4] for s, v in points])

    def of_rows(*flat):
        return outputs(flat, jnp)

    # Rows do not mix: one pass over 16 copies of them, each moved along another input.
    copies = [jnp.asarray(column) for column in np.tile(inputs, (16, 1)).T]
    along = [jnp.asarray(column) for column in np.repeat(np.eye(16), len(points), axis=0).T]
    forward = np.stack(jax.jvp(of_rows, copies, along)[1])
    weights = np.random.default_rng(0).normal(size=(len(forward), 1)) * np.ones(16 * len(points))
    reverse = np.stack(jax.vjp(of_rows, *copies)[1]([jnp.asarray(w) for w in weights]))
    assert np.isfinite(forward).all()
    np.testing.assert_allclose((reverse * np.stack(along)).sum(0), (forward * weights).sum(0), rtol=1e-9, atol=1e-9)
    forward = forward.reshape(-1, 16, len(points))
    for i, unit in enumerate(np.repeat([1.0, 1e-3, 1.0, SMALL_VELOCITY], 4)):
        h = np.zeros(16)
        h[i] = 1e-5 * unit
        high, low = (np.stack(outputs((inputs + way * h).T, np)) for way in (1.0, -1.0))
        np.testing.assert_allclose(unit * forward[:, i], (high - low) / 2e-5, rtol=1e-6, atol=1e-9)


def test_one_presliding_or_four():
    s, v = (0.1, -0.2, 0.3, 0.4), (0.01, 0.02, -0.03, 0.04)
    wanted = np.array(step(NOMINAL, s, v, 1e-3, FLOATS))
    for z in ((PRESLIDING,) * 4, np.full(4, PRESLIDING), np.array(PRESLIDING)):
        found = step(Friction(np.array(COULOMB), z), s, v, 1e-3, FLOATS)
        np.testing.assert_allclose(np.array(found), wanted, rtol=1e-12)
    each = np.array(step(Friction(COULOMB, (1e-3, 2e-3, 1e-3, 1e-3)), s, v, 1e-3, FLOATS))
    assert (each != wanted).nonzero()[1].tolist() == [1, 1]
