"""The active observer of order N: the random walk that it assumes, what it follows without error, what N = 1 costs."""

from math import comb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from jaxmpc import InputError, Params, design, margins
from jaxmpc.engine.base import scalars
from jaxmpc.engine.linear_scan import record
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.loop.linear import AxisSignals
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis.plant import contact_model
from jaxmpc.world.loop_path import loop_path

T_S = 1e-3
VALUES: dict[str, Any] = {"K2": 40.0, "Khat_s": 550.0, "T_cl": 2e-4}
NOISE = {1: 0.1, 2: 1e-4, 3: 1e-6}
"""Q_p of each order [(m/s²)²/N²]."""


def params_of(order: int) -> Params:
    return Params.from_dict({**VALUES, "Q_p": NOISE[order], "disturbance_order": order})


def plain(gains: Gains) -> Gains:
    """The law on Python floats, for a reference held constant."""
    return constant_reference(jax.tree.map(lambda field: np.asarray(field).tolist(), gains))


def delayed_plant(params: Params) -> tuple[np.ndarray, np.ndarray]:
    """Φᵣ and Γᵣ as the paper writes them."""
    Phi, Gamma = contact_model(jnp.asarray(params.Khat_s), jnp.asarray(params.K2), T_S)
    Phi_r = np.zeros((3, 3))
    Phi_r[:2, :2], Phi_r[:2, 2] = Phi, Gamma
    return Phi_r, np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_estimates_are_those_of_the_random_walk_of_past_values(order: int) -> None:
    """Σⱼ (−1)ʲ C(N,j) pₖ₋ⱼ = wₖ on the state (pₖ, …, pₖ₋ₙ₊₁): the same p̂ and x̂ as from differences, always."""
    params = params_of(order)
    Phi_r, Gamma_r = delayed_plant(params)
    Phi = np.zeros((3 + order, 3 + order))
    Phi[:3, :3], Phi[:3, 3] = Phi_r, Gamma_r
    Phi[3, 3:] = [-((-1) ** j) * comb(order, j) for j in range(1, order + 1)]
    Phi[4:, 3:-1] = np.eye(order - 1)
    c = np.eye(3 + order)[0]
    Q = np.diag([float(params.Q_x)] * 3 + [float(params.Q_p)] + [0.0] * (order - 1))
    P = scipy.linalg.solve_discrete_are(Phi.T, c[:, None], Q, np.eye(1))
    K = P @ c / (c @ P @ c + 1.0)
    gains = plain(design(params))
    # The two Riccati equations meet to scipy's digits, which past values cost some of.
    np.testing.assert_allclose(gains.K[:4], K[:4], rtol=1e-7)

    state, walk, v = cascade.init(gains), np.zeros(3 + order), 0.0
    for y in np.random.default_rng(2).standard_normal(500).tolist():
        prior = Phi @ walk + v * np.eye(3 + order)[2]
        walk = prior + K * (y - prior[0])
        state, v = cascade.step(gains, state, y, (0.0,))
        np.testing.assert_allclose([*state.x_hat, state.p_hat], walk[:4], rtol=1e-5, atol=1e-5 * np.abs(walk).max())


def run(order: int, degree: int) -> tuple[float, float]:
    """Largest error of p̂ [m/s²] and of the force [N] from 3 to 4 s, under the disturbance tⁿ, t in seconds."""
    params = params_of(order)
    gains = plain(design(params))
    Phi_r, Gamma_r = delayed_plant(params)
    state, x, missed = cascade.init(gains), np.zeros(3), []
    for k in range(4000):
        disturbance = (k * T_S) ** degree
        state, v = cascade.step(gains, state, float(x[0]), (1.0,))
        missed.append((abs(state.p_hat - disturbance), abs(x[0] - 1.0)))
        x = Phi_r @ x + Gamma_r * (v + disturbance)
    p, force = np.max(missed[3000:], axis=0)
    return float(p), float(force)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_polynomial_below_the_order_is_followed_without_error_and_no_other(order: int) -> None:
    """Constant, ramp, parabola on the plant of the design: what is left at 3 s is rounding."""
    p, force = run(order, order - 1)
    assert p < 1e-10
    assert force < 1e-10
    p, force = run(order, order)
    assert p > 1e-4
    assert force > 1e-6


def test_order_one_costs_what_it_did() -> None:
    """33 operations an axis; each order more adds a prediction and a correction with its product."""

    def operations(order: int) -> int:
        gains = jax.tree.map(jnp.asarray, plain(design(params_of(order))))
        state = cascade.init(gains, jnp.asarray(0.0))
        return len(jax.make_jaxpr(lambda g, s: cascade.step(g, s, 1.0, (1.0,)))(gains, state).eqns)

    assert [operations(order) for order in (1, 2, 3)] == [33, 36, 39]


@pytest.mark.parametrize("order", [2, pytest.param(3, marks=pytest.mark.oracle)])
def test_the_engine_runs_the_loop_that_scipy_runs(independent_loop: Any, order: int) -> None:
    params = params_of(order)
    gains, noise = design(params), 0.1 * np.random.default_rng(4).standard_normal((1000, 3))
    contact = contact_of(810.0, params.K2, loop_path(ideal=True))
    heart = 1e-3 * noise[:, 0]
    signals = AxisSignals(*map(jnp.asarray, (heart, noise[:, 1], noise[:, 2:], np.ones(1000))))
    sample = jax.jit(record)(scalars(gains, preview=False), contact, jnp.asarray(0.0), signals)
    loop = independent_loop(gains, 810.0, float(params.K2))
    _, expected, _ = scipy.signal.dlsim((*loop, T_S), np.column_stack([heart, noise[:, 1:]]))
    np.testing.assert_allclose(sample.force, expected[:, 0], atol=1e-9 * np.abs(expected).max())


@pytest.mark.oracle
def test_slope_of_a_margin_of_order_two_is_the_central_difference() -> None:
    def peak(log_q: jax.Array) -> jax.Array:
        return margins(Params(**VALUES, Q_p=jnp.exp(log_q), disturbance_order=2), 810.0).M_s

    both = jax.jit(jax.value_and_grad(peak))  # one program
    at, step = jnp.log(1e-4), 1e-5
    difference = float(both(at + step)[0] - both(at - step)[0]) / (2.0 * step)
    assert float(both(at)[1]) == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize("order", [0, 4, 2.0, True, "2", None])
def test_an_order_that_does_not_exist_is_refused(order: Any) -> None:
    with pytest.raises(InputError, match=r"disturbance_order = .*must be 1, 2 or 3"):
        Params.from_dict({"disturbance_order": order})


def test_order_is_structure() -> None:
    params = params_of(2)
    assert Params.from_dict(params.to_dict()).disturbance_order == 2
    assert params.with_columns({"K2": [1.0, 2.0]})[1].disturbance_order == 2
    with pytest.raises(InputError, match="disturbance_order = 1, 2: must be one for the whole batch"):
        Params.stack([Params(), params])
    with pytest.raises(InputError, match='must be 1 with the architecture "mpc"'):
        Params(architecture="mpc", disturbance_order=2)
