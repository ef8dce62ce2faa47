"""Design against scipy, brute force and central differences; horizons against exact ones; compilations counted."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from jaxmpc import Params, design
from jaxmpc.law.gains import Gains
from jaxmpc.quantities import HP_MAX, HU_MAX
from jaxmpc.synthesis import _design, design_one
from jaxmpc.synthesis.feedback import state_feedback
from jaxmpc.synthesis.kalman import dare
from jaxmpc.synthesis.mpc import first_move, horizon_mask
from jaxmpc.synthesis.plant import closed_loop_model, contact_model

T_S = 1e-3


@pytest.mark.parametrize("K2", [0.0, 1e-9, 1e-3, 10.0, 100.0, 499.0, 501.0, 5000.0])
def test_contact_model_is_the_zero_order_hold(K2: float) -> None:
    continuous = (np.array([[0.0, 1.0], [0.0, -K2]]), np.array([[0.0], [900.0]]), np.eye(2), np.zeros((2, 1)))
    Phi, Gamma, *_ = scipy.signal.cont2discrete(continuous, T_S)
    ours = contact_model(jnp.float64(900.0), jnp.float64(K2), T_S)
    np.testing.assert_allclose(ours[0], Phi, rtol=1e-9)
    np.testing.assert_allclose(ours[1], Gamma[:, 0], rtol=1e-9)


@pytest.mark.parametrize("T_cl", [1e-4, 2e-4, 1e-3, 3e-3, 2e-2])
def test_closed_loop_model_is_the_zero_order_hold(T_cl: float) -> None:
    a = 1.0 / T_cl
    continuous = (np.array([[0.0, 1.0], [-a * a, -2.0 * a]]), np.array([[0.0], [a * a]]), np.eye(2), np.zeros((2, 1)))
    A, B, *_ = scipy.signal.cont2discrete(continuous, T_S)
    ours = closed_loop_model(jnp.float64(T_cl), T_S)
    # scipy's matrix exponential itself is good to about 1e-13 of the largest entry, a².
    np.testing.assert_allclose(ours[0], A, rtol=1e-9, atol=1e-13 * a * a)
    np.testing.assert_allclose(ours[1], B[:, 0], rtol=1e-9)


def delayed(Phi: np.ndarray, Gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plant with its one sample of delay, written out as the paper does."""
    Phi_r = np.zeros((3, 3))
    Phi_r[:2, :2], Phi_r[:2, 2] = Phi, Gamma
    return Phi_r, np.array([[0.0], [0.0], [1.0]])


@pytest.mark.parametrize(("K2", "Khat_s", "T_cl"), [(10.0, 900.0, 3e-3), (100.0, 300.0, 2e-4), (0.0, 1900.0, 2e-2)])
def test_feedback_places_the_poles(K2: float, Khat_s: float, T_cl: float) -> None:
    """The characteristic polynomial is compared: repeated poles read back by eigenvalues lose half the digits."""
    Phi, Gamma = contact_model(jnp.float64(Khat_s), jnp.float64(K2), T_S)
    L = np.asarray(state_feedback(Phi, Gamma, jnp.float64(T_cl), T_S))
    Phi_r, Gamma_r = delayed(np.asarray(Phi), np.asarray(Gamma))
    pole = np.exp(-T_S / T_cl)
    np.testing.assert_allclose(np.poly(Phi_r - Gamma_r @ L[None]), np.poly([pole, pole, 0.0]), atol=1e-9)


def test_input_gain_makes_the_dc_gain_one() -> None:
    gains = design(Params.published("text"))
    Phi, Gamma = contact_model(jnp.float64(900.0), jnp.float64(10.0), T_S)
    Phi_r, Gamma_r = delayed(np.asarray(Phi), np.asarray(Gamma))
    closed = Phi_r - Gamma_r @ np.asarray(gains.L)[None]
    assert np.linalg.solve(np.eye(3) - closed, Gamma_r[:, 0] * gains.input_gain)[0] == pytest.approx(1.0, abs=1e-9)


def augmented(params: Params) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Φₐ, Cₐ, Q, R of the active observer, written out from the paper's (11)–(14), with a Jordan block for p."""
    Phi, Gamma = contact_model(jnp.asarray(params.Khat_s), jnp.asarray(params.K2), T_S)
    order = params.disturbance_order
    Phi_a = np.zeros((3 + order, 3 + order))
    Phi_a[:3, :3], Gamma_r = delayed(np.asarray(Phi), np.asarray(Gamma))
    Phi_a[:3, 3:4] = Gamma_r
    Phi_a[3:, 3:] = np.eye(order) + np.eye(order, k=1)
    Q = np.diag([float(params.Q_x)] * 3 + [0.0] * (order - 1) + [float(params.Q_p)])
    return Phi_a, np.eye(3 + order)[0], Q, float(params.R)


@pytest.mark.parametrize(
    "params",
    [
        Params(),
        Params(Khat_s=500.0),
        Params(Q_p=100.0, Q_x=1e-2, K2=100.0),
        Params(Q_p=0.01, R=2.0, Khat_s=1900.0),
        *(Params(Q_p=Q_p, K2=40.0, disturbance_order=2) for Q_p in (1.0, 1e-6)),
        *(Params(Q_p=Q_p, K2=40.0, disturbance_order=3) for Q_p in (1.0, 1e-9)),
    ],
)
def test_riccati_solution_is_scipys(params: Params) -> None:
    Phi, c, Q, R = augmented(params)
    expected = scipy.linalg.solve_discrete_are(Phi.T, c[:, None], Q, np.array([[R]]))
    found = dare(jnp.asarray(Phi), jnp.asarray(c), jnp.asarray(Q), jnp.float64(R))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    K = expected @ c / (c @ expected @ c + R)
    np.testing.assert_allclose(design(params).K, K, rtol=1e-9)


def test_riccati_solution_needs_no_process_noise_on_the_states() -> None:
    """Q_x exactly zero still gives the printed digits; scipy's pencil is singular to its tolerance there."""
    gains = design(Params(Khat_s=500.0, Q_x=0.0))
    assert [f"{x:.4g}" for x in gains.K] == ["0.1236", "8.145", "0.662", "0.662"]


def brute_force_row(A: np.ndarray, B: np.ndarray, lam: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, ...]:
    """First move by least squares on simulated predictions: no formula of the paper is used."""
    hp, hu = len(delta), len(lam)

    def predict(x: np.ndarray, u: float, moves: np.ndarray) -> np.ndarray:
        forces = []
        for i in range(hp):
            u = u + (moves[i] if i < hu else 0.0)
            x = A @ x + B * u
            forces.append(x[0])
        return np.array(forces)

    n = len(B)
    effect = np.column_stack([predict(np.zeros(n), 0.0, np.eye(hu)[j]) for j in range(hu)])
    stacked = np.vstack([np.sqrt(delta)[:, None] * effect, np.diag(np.sqrt(lam))])

    def first(target: np.ndarray) -> float:
        wanted = np.concatenate([np.sqrt(delta) * target, np.zeros(hu)])
        return float(np.linalg.lstsq(stacked, wanted, rcond=None)[0][0])

    ref = np.array([first(np.eye(hp)[i]) for i in range(hp)])
    state = np.array([first(predict(np.eye(n)[i], 0.0, np.zeros(hu))) for i in range(n)])
    return ref, state, np.array(first(predict(np.zeros(n), 1.0, np.zeros(hu))))


@pytest.mark.parametrize(
    ("Hp", "Hu", "lam", "T_cl"), [(30, 5, 0.1, 3e-3), (64, 16, 0.01, 1e-2), (3, 3, 10.0, 2e-4), (1, 1, 1.0, 3e-3)]
)
def test_mpc_row_is_the_least_squares_solution(Hp: int, Hu: int, lam: float, T_cl: float) -> None:
    A, B = map(np.asarray, closed_loop_model(jnp.float64(T_cl), T_S))
    ref, state, previous = brute_force_row(A, B, np.full(Hu, lam), np.full(Hp, 0.9))
    gains = design(Params(Hp=Hp, Hu=Hu, lam=lam, T_cl=T_cl))
    np.testing.assert_allclose(gains.mpc_ref[:Hp], ref, rtol=1e-9, atol=1e-9 * np.abs(ref).max())
    np.testing.assert_allclose(gains.mpc_x, state, rtol=1e-9)
    np.testing.assert_allclose(gains.mpc_u, previous, rtol=1e-9)
    assert not np.any(gains.mpc_ref[Hp:])


def test_diagonals_of_weights_reach_the_least_squares_solution() -> None:
    lam, delta = np.linspace(0.05, 0.4, 5), np.linspace(1.0, 0.2, 30)
    A, B = map(np.asarray, closed_loop_model(jnp.float64(3e-3), T_S))
    ref, state, previous = brute_force_row(A, B, lam, delta)
    gains = design(Params.from_dict({"lam": lam.tolist(), "delta": delta.tolist()}))
    np.testing.assert_allclose(gains.mpc_ref[:30], ref, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose([*gains.mpc_x, gains.mpc_u], [*state, previous], rtol=1e-9)


def test_classical_mpc_row_predicts_the_open_loop_plant() -> None:
    Phi, Gamma = contact_model(jnp.float64(900.0), jnp.float64(10.0), T_S)
    A, B = delayed(np.asarray(Phi), np.asarray(Gamma))
    ref, state, previous = brute_force_row(A, B[:, 0], np.full(5, 0.1), np.full(30, 0.9))
    gains = design(Params(architecture="mpc"))
    np.testing.assert_allclose(gains.mpc_ref[:30], ref, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(gains.mpc_x, state[:2], rtol=1e-9)
    np.testing.assert_allclose(gains.mpc_u, previous + state[2], rtol=1e-9)


def exact_row(Hp: int, Hu: int, A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The paper's (20)–(22) and (29) with matrices of the exact size, summed for a constant reference."""
    powers = [np.linalg.matrix_power(A, i) for i in range(Hp + 1)]
    sums = np.cumsum([p @ B for p in powers[:Hp]], axis=0)[:, 0]
    Theta = np.array([[sums[i - j] if i >= j else 0.0 for j in range(Hu)] for i in range(Hp)])
    first = np.linalg.solve(0.9 * Theta.T @ Theta + 0.1 * np.eye(Hu), 0.9 * Theta.T)[0]
    Psi = np.array([p[0] for p in powers[1:]])
    return np.array([first.sum(), *(first @ Psi), first @ sums])


def test_masked_horizons_are_the_exact_ones_for_all_pairs_in_one_compilation() -> None:
    pairs = [(hp, hu) for hp in range(1, HP_MAX + 1) for hu in range(1, min(hp, HU_MAX) + 1)]
    assert len(pairs) == 904
    before = _design.programs
    batch = Params().with_columns({"Hp": [p[0] for p in pairs], "Hu": [p[1] for p in pairs]})
    gains = design(batch)
    assert _design.programs == before + 1
    A, B = map(np.asarray, closed_loop_model(jnp.float64(3e-3), T_S))
    rows = np.column_stack([np.sum(gains.mpc_ref, axis=1), gains.mpc_x, gains.mpc_u])
    expected = np.array([exact_row(hp, hu, A, B) for hp, hu in pairs])
    np.testing.assert_allclose(rows, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max(axis=0).min())


def test_changing_numbers_never_recompiles() -> None:
    design(Params())
    before = _design.programs
    for values in ({"Q_p": 1.0}, {"T_cl": 2e-4, "Hp": 12}, {"K2": 0.0, "Hu": 2, "lam": 3.0}):
        design(Params(**values))
    assert _design.programs == before


def test_long_horizons_reach_the_linear_quadratic_regulator() -> None:
    """With H_p, H_u → ∞ the move is the LQR's on [force, force rate, u₋₁] with input Δu."""
    A, B = map(np.asarray, closed_loop_model(jnp.float64(1e-3), T_S))
    A_u = np.block([[A, B[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    B_u = np.array([*B, 1.0])[:, None]
    Q = A_u[:1].T @ A_u[:1] * 0.9
    S, R = 0.9 * A_u[:1].T * B_u[0, 0], np.array([[0.1 + 0.9 * B_u[0, 0] ** 2]])
    P = scipy.linalg.solve_discrete_are(A_u, B_u, Q, R, s=S)
    feedback = np.linalg.solve(B_u.T @ P @ B_u + R, B_u.T @ P @ A_u + S.T)[0]
    gains = design(Params(Hp=HP_MAX, Hu=HU_MAX, T_cl=1e-3))
    # 16 moves are not infinitely many: what is left decays by a factor of about 2 per move.
    np.testing.assert_allclose([*gains.mpc_x, gains.mpc_u], feedback, rtol=1e-3)


def test_batch_equals_one_by_one() -> None:
    batch = Params.stack([Params(), Params(Hp=10, Hu=2, Q_p=3.0), Params(K2=80.0, T_cl=3e-4)])
    together = design(batch)
    for row in range(3):
        alone = design(batch[row])
        for ours, theirs in zip(*map(jax.tree.leaves, (together, alone)), strict=True):
            np.testing.assert_allclose(ours[row], theirs, rtol=1e-12)


def test_mask_is_exact_at_width_one_and_feels_its_horizon_when_wider() -> None:
    np.testing.assert_array_equal(horizon_mask(jnp.float64(3.0), 6), [1, 1, 1, 0, 0, 0])
    slope = jax.grad(lambda h: jnp.sum(horizon_mask(h, 20, 8.0)))(10.0)
    assert slope == pytest.approx(1.0)


NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")
POINT = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))


@cache
def weighed(architecture: str, order: int, delay: int) -> tuple[Any, Any, np.ndarray]:
    """A sum of all gains over their sizes, its reverse gradient at POINT, and the central difference there.

    Values come from the gradient's own program, so that there is but one.
    """
    kind: dict[str, Any] = {
        "architecture": architecture,
        "disturbance_order": order,
        "designed_delay": delay,
    }
    shapes = [(2,), (2,), (3 + order,), (3,), (), (HP_MAX,), (2,), (), *[()] * (delay - 1)]
    weights = [np.random.default_rng(i).standard_normal(shape) for i, shape in enumerate(shapes)]

    def summary(x: jax.Array, scales: Any) -> tuple[jax.Array, Gains]:
        values = dict(zip(NAMES, jnp.exp(x), strict=True))
        gains = design_one(Params(**values, **kind), T_S)[0]
        return sum(jnp.sum(w * g / s) for w, g, s in zip(weights, jax.tree.leaves(gains), scales, strict=True)), gains

    both = jax.jit(jax.value_and_grad(summary, has_aux=True))
    (_, gains), _ = both(POINT, [1.0] * len(shapes))
    scales = [max(1.0, float(jnp.max(jnp.abs(g)))) for g in jax.tree.leaves(gains)]
    step = 1e-5

    def central(i: int) -> float:
        above, below = (both(POINT.at[i].add(side), scales)[0][0] for side in (step, -step))
        return float(above - below) / (2.0 * step)

    difference = np.array([central(i) for i in range(len(POINT))])
    return lambda x: summary(x, scales)[0], both(POINT, scales)[1], difference


@pytest.mark.parametrize(
    ("architecture", "order", "delay"),
    [
        *(pytest.param(name, 1, 1, marks=pytest.mark.oracle) for name in ("mpc-aob", "aob", "mpc")),
        pytest.param("mpc-aob", 2, 1),
        *(pytest.param(name, 1, 2, marks=pytest.mark.oracle) for name in ("mpc-aob", "mpc")),
    ],
)
@pytest.mark.parametrize("mode", [pytest.param("forward", marks=pytest.mark.oracle), "reverse"])
def test_gradient_of_the_design_is_the_central_difference(architecture: str, order: int, delay: int, mode: str) -> None:
    """Relative to the largest component over log-parameters: scale-free, and R and δ stay fixed."""
    total, gradient, difference = weighed(architecture, order, delay)
    if mode == "forward":
        gradient = jax.jit(jax.jacfwd(total))(POINT)
    np.testing.assert_allclose(gradient, difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.oracle
def test_redundant_scales_cancel() -> None:
    """Only λ/δ and Q/R act."""

    def total(logs: jax.Array) -> jax.Array:
        lam, delta, Q_p, Q_x, R = jnp.exp(logs)
        gains, _ = design_one(Params(lam=lam, delta=delta, Q_p=Q_p, Q_x=Q_x, R=R), T_S)
        return jnp.sum(gains.K) + gains.mpc_u

    g = np.asarray(jax.grad(total)(jnp.log(jnp.array([0.1, 0.9, 0.5, 1e-6, 1.0]))))
    assert g[0] == pytest.approx(-g[1], rel=1e-9)
    assert g[2] + g[3] == pytest.approx(-g[4], rel=1e-9)


def test_first_move_of_a_relaxed_column_costs_more() -> None:
    """A column weighted m counts as one whose move costs λ/m²; the first always counts whole."""
    A, B = closed_loop_model(jnp.float64(3e-3), T_S)
    Hp, Hu, width = 20.0, 4.0, 6.0
    lam, delta = np.linspace(0.05, 0.2, HU_MAX), np.full(HP_MAX, 0.9)
    soft = first_move(A, B, jnp.asarray(lam), jnp.asarray(delta), jnp.float64(Hp), jnp.float64(Hu), width)
    columns, errors = (np.asarray(horizon_mask(jnp.float64(H), n, width)) for H, n in ((Hu, HU_MAX), (Hp, HP_MAX)))
    there = columns > 0.0
    assert 2 < np.sum(columns[there] < 1.0) < np.sum(there)
    whole = int(np.sum(there))
    expected = brute_force_row(np.asarray(A), np.asarray(B), lam[there] / columns[there] ** 2, delta * errors)
    assert whole == np.flatnonzero(there)[-1] + 1
    for ours, theirs in zip(soft, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-12)
