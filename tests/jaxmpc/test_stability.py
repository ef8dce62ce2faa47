"""Margins against their own definition on an independent model, python-control, and central differences."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import InputError, Params, Status, design, margins, stability
from jaxmpc.law import cascade
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.stability import CELLS
from jaxmpc.stability.controller import filter_response
from jaxmpc.stability.crossings import loop_margins
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius, transition_matrix
from jaxmpc.stability.response import loop_response
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import hertz, move, sense
from jaxmpc.world.contact import init as begin_contact
from jaxmpc.world.loop_path import loop_path

T_S = 1e-3
SENSOR = hertz(500.0)
TUNED = Params(K2=100.0, Khat_s=970.0, Q_p=10.0, T_cl=2e-4)
RAMP = Params(K2=40.0, Khat_s=550.0, Q_p=1e-6, T_cl=2e-4, disturbance_order=2)
PARABOLA = Params(K2=40.0, Khat_s=550.0, Q_p=1e-9, T_cl=2e-4, disturbance_order=3)
CLASSICAL = Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10)
LATE = [
    (Params(designed_delay=2), 810.0, 2, True),
    (Params.from_dict({**Params.published("cautious").to_dict(), "designed_delay": 2}), 1900.0, 2, False),
    (Params(K2=40.0, Khat_s=550.0, Q_p=1e-9, disturbance_order=3, designed_delay=2), 600.0, 2, False),
    (Params(architecture="aob", designed_delay=2), 810.0, 1, False),
    (Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10, designed_delay=2), 600.0, 2, False),
]
"""Designed for two samples of delay."""
CASES = [
    (Params(), 375.0, 1, True),
    (Params(), 810.0, 2, True),
    (Params(), 1900.0, 1, False),
    (Params.published("printed"), 1200.0, 1, False),
    (TUNED, 1900.0, 1, False),
    (TUNED, 375.0, 1, True),
    (RAMP, 600.0, 1, False),
    (Params(architecture="aob"), 810.0, 1, False),
    (CLASSICAL, 810.0, 1, True),
]
PARABOLIC = (PARABOLA, 600.0, 2, False)
Cut = tuple[Any, Any, float]


@partial(jax.jit, static_argnames="ideal")
def cut_margins(params: Params, K_s: Any, delay: Any, ideal: bool, cut: Any) -> Any:
    gains, _ = design_one(params, T_S)
    contact = contact_of(K_s, params.K2, replace(loop_path(ideal=ideal), delay=delay))

    def loop(theta: Any, late: Any = None) -> Any:
        return loop_response(gains, contact, theta, cut, late)

    return loop_margins(loop, loop, T_S)


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES, *LATE])
def test_the_cut_at_the_force_is_the_cut_at_v(params: Params, K_s: float, delay: int, ideal: bool) -> None:
    """What comes back of a force added to the measured one, from one sample of law and world, differentiated."""
    gains = design(params)
    gains = gains._replace(mpc_ref=gains.mpc_ref[:1])
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))

    def one_sample(controller: Any, world: Any) -> Any:
        state, added, _ = world
        force, state = sense(contact, state, jnp.zeros(()))
        controller, v = cascade.step(gains, controller, force + added, (jnp.zeros(()),))
        return controller, (move(contact, state, v)[0], jnp.zeros(()), force + added)

    begin = cascade.init(gains, jnp.zeros(())), (begin_contact(jnp.zeros(())), jnp.zeros(()), jnp.zeros(()))
    whole = np.asarray(transition_matrix(gains, one_sample, *begin))
    A, B, C = whole[:-2, :-2], whole[:-2, -2], whole[-1, :-2]
    for theta in np.geomspace(1e-2, 3.1, 40):
        S = 1.0 + C @ np.linalg.solve(np.exp(1j * theta) * np.eye(len(A)) - A, B)
        expected = 1.0 / (1.0 + complex(loop_response(gains, contact, theta, 0.0)))
        # Both lose digits near the loops' poles, which lie at 1 within some 1e-3.
        assert abs(S - expected) < 1e-8 * abs(expected)


def radius(A: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max())


@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES, PARABOLIC, *LATE])
def test_spectral_radius_is_that_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    gains = design(params)
    sensor = 0.0 if ideal else SENSOR
    A, *_ = independent_loop(gains, K_s, float(params.K2), delay, ideal, sensor)
    keep = np.arange(len(A)) != 2 + params.designed_delay if params.architecture == "mpc" else slice(None)
    expected = radius(A[:, keep][keep])
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    assert float(spectral_radius(closed_loop_matrix(gains, contact))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("cut", [0.0, 1.0])
@pytest.mark.parametrize(
    ("params", "K_s", "delay", "ideal"),
    [*CASES[:4], LATE[1], *(pytest.param(*case, marks=pytest.mark.oracle) for case in (*CASES[4:], *LATE[2:]))],
)
def test_gain_or_delay_at_the_margin_puts_a_pole_on_the_unit_circle(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool, cut: float
) -> None:
    """The definition itself, with eigenvalues of a loop in which exactly that gain or delay was put."""
    gains, place = design(params), "a" if cut else "v"
    build = partial(independent_loop, gains, K_s, float(params.K2), delay, ideal, 0.0 if ideal else SENSOR)
    found = cut_margins(params, K_s, float(delay), ideal, cut)

    def at_the_limit(**change: float) -> float:
        A, *_ = build(**change)
        keep = np.arange(len(A)) != 2 + params.designed_delay if params.architecture == "mpc" else slice(None)
        return radius(A[keep][:, keep])

    for gain_db in (float(found.gain_margin_db), -float(found.gain_reduction_db)):
        if np.isfinite(gain_db):
            assert at_the_limit(**{f"gain_{place}": 10 ** (gain_db / 20)}) == pytest.approx(1.0, abs=1e-6)
    late = float(found.delay_margin_s) / T_S
    assert at_the_limit(**{f"late_{place}": late}) == pytest.approx(1.0, abs=1e-6)
    assert at_the_limit(**{f"late_{place}": 0.98 * late}) < 1.0


NARROW = [
    (Params(Khat_s=986, K2=11.1, Q_p=0.011, lam=0.003, Hp=47, Hu=16, T_cl=0.88e-3), 734.0),
    (Params(Khat_s=1830, K2=38.3, Q_p=0.213, Q_x=0.0077, lam=0.0023, Hp=13, Hu=3, T_cl=3.3e-3), 375.0),
    (Params(Khat_s=1198, K2=11.2, Q_p=0.0935, Q_x=3.6e-9, lam=0.00394, Hp=18, Hu=2, T_cl=4.68e-3), 810.0),
    (Params(Khat_s=2237, K2=58.0, Q_p=0.067, Q_x=2.8e-10, lam=0.00205, Hp=63, Hu=13, T_cl=4.56e-3), 375.0),
    (Params(Khat_s=665.3, K2=3.0, Q_p=5.1, Q_x=1.27e-5, lam=0.00611, Hp=22, Hu=3, T_cl=2.01e-3), 375.0),
]
"""Resonances narrower than the first search is fine: of |L| near 1, the last one of |1/(1 + L)|."""


def check_delay_margin(build: Callable[..., Any], gains: Any, params: Params, K_s: float, step: float) -> bool:
    """The loop with so much delay put in: stable up to the margin, on the stability limit at it.

    Args:
        build: The independent loop.
        gains: Of the controller.
        params: Its parameters.
        K_s: Stiffness [N/m].
        step: Between the delays looked at [samples].

    Returns:
        Whether there was one to look at.
    """
    if not radius(build(gains, K_s, float(params.K2), 1, False, SENSOR)[0]) < 1.0:
        return False
    for cut, place in ((0.0, "late_v"), (1.0, "late_a")):
        # The queues of the independent loop hold 22 samples.
        limit = float(cut_margins(params, K_s, 1.0, False, cut).delay_margin_s) / T_S
        looked_at = np.arange(step, min(0.99 * limit, 22.0), step)
        loops = [build(gains, K_s, float(params.K2), 1, False, SENSOR, **{place: late})[0] for late in looked_at]
        assert all(radius(A) < 1.0 for A in loops), (K_s, place, limit)
        if limit < 22.0:
            A, *_ = build(gains, K_s, float(params.K2), 1, False, SENSOR, **{place: limit})
            assert radius(A) == pytest.approx(1.0, abs=1e-6)
    return True


@pytest.mark.parametrize(("params", "K_s"), NARROW)
def test_delay_margin_at_a_narrow_resonance(independent_loop: Callable[..., Any], params: Params, K_s: float) -> None:
    assert check_delay_margin(independent_loop, design(params), params, K_s, 0.25)


@pytest.mark.parametrize("count", [8, pytest.param(400, marks=pytest.mark.slow)])
def test_delay_margins_of_random_designs(independent_loop: Callable[..., Any], count: int) -> None:
    random = np.random.default_rng(5)
    bounds = {"lam": (1e-3, 3.0), "Q_p": (1e-3, 30.0), "Q_x": (1e-12, 1e-2), "T_cl": (2e-4, 5e-3), "K2": (3.0, 100.0)}
    compared = 0
    for _ in range(count):
        values = {name: float(np.exp(random.uniform(*np.log(pair)))) for name, pair in bounds.items()}
        Hp, K_s = int(random.integers(8, 64)), float(np.exp(random.uniform(*np.log([375.0, 1900.0]))))
        Khat_s = K_s * float(np.exp(random.uniform(-0.7, 0.7)))
        params = Params(**values, Hp=Hp, Hu=int(random.integers(1, 9)), Khat_s=Khat_s)
        compared += check_delay_margin(independent_loop, design(params), params, K_s, 0.5)
    assert compared > count // 2


@pytest.mark.parametrize("cut", [0.0, 1.0])
def test_narrow_resonances_are_in_every_margin(cut: float) -> None:
    """Against the least and greatest over 60000 angles."""
    theta = np.geomspace(1e-3, np.pi, 60_000)
    for params, K_s in NARROW:
        gains, contact = jax.tree.map(np.asarray, (design(params), contact_of(K_s, params.K2, loop_path())))
        response = np.asarray(loop_response(gains, contact, theta, cut))
        crossing = response.imag[:-2] * response.imag[1:-1] < 0.0
        level = -np.append(response.real[:-2][crossing], response.real[-1])
        decibels = -20.0 * np.log10(level[level > 0.0])
        lag = np.angle(-response[:-1][np.diff(np.sign(np.log(np.abs(response)))) != 0], deg=True)
        found = cut_margins(params, K_s, 1.0, False, cut)
        assert float(found.M_s) == pytest.approx(1.0 / np.abs(1.0 + response).min(), rel=1e-3)
        assert float(found.gain_margin_db) == pytest.approx(decibels[decibels > 0.0].min(), rel=2e-3)
        assert float(found.gain_reduction_db) == pytest.approx(-decibels[decibels < 0.0].max(initial=-np.inf), rel=2e-3)
        assert float(found.phase_margin_deg) == pytest.approx(np.mod(lag, 360.0).min(), abs=0.1)


@pytest.mark.parametrize("cut", [0.0, 1.0])
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), CASES[:7])
def test_margins_are_those_of_python_control(params: Params, K_s: float, delay: int, ideal: bool, cut: float) -> None:
    """On frequency data: its polynomial route finds false crossings here."""
    gains = design(params)
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    omega = np.geomspace(0.5, 0.9999 * np.pi / T_S, 5_000)
    data = control.FRD(np.asarray(loop_response(gains, contact, jnp.asarray(omega * T_S), cut)), omega, smooth=True)
    gain, phase, distance, *_ = control.stability_margins(data, returnall=True)
    found = cut_margins(params, K_s, float(delay), ideal, cut)
    decibels = 20 * np.log10(gain)
    assert float(found.gain_margin_db) == pytest.approx(decibels[decibels > 0].min(initial=np.inf), rel=1e-3)
    assert float(found.gain_reduction_db) == pytest.approx((-decibels[decibels < 0]).min(initial=np.inf), rel=1e-3)
    assert float(found.phase_margin_deg) == pytest.approx(np.mod(phase, 360.0).min(), rel=1e-3)
    assert float(found.M_s) == pytest.approx(1.0 / distance.min(), rel=1e-3)


@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES[:7], PARABOLIC, *LATE])
def test_closed_form_response_is_that_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    """1/(1 + L) is also the response of the running loop, from noise added before the cut to behind it.

    Noise on the sensor sees the force loop alone: y/noise = 1/(1 + L_v) when cut at v.
    """
    gains = design(params)
    sensor = 0.0 if ideal else SENSOR
    A, B, C, D = independent_loop(gains, K_s, float(params.K2), delay, ideal, sensor)
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    for omega in 2 * np.pi * np.array([0.7, 5.0, 30.0, 120.0, 450.0]):
        z = np.exp(1j * omega * T_S)
        expected = (C @ np.linalg.solve(z * np.eye(len(A)) - A, B[:, 1]) + D[:, 1])[0]
        ours = 1.0 / (1.0 + loop_response(gains, contact, jnp.float64(omega * T_S), 0.0))
        np.testing.assert_allclose(complex(ours), expected, rtol=1e-8)


FILTERED = loop_path(force_filter=ForceFilter(T_S, 0.3, 40.0))


def test_filter_of_the_force_is_that_of_python_control() -> None:
    """Constant rate, corrected by the innovation; at once, so the output is that after the correction."""
    T_s, K_y, K_r = FILTERED.force_filter
    predict, K = np.array([[1.0, T_s], [0.0, 1.0]]), np.array([[K_y], [K_r]])
    A = (np.eye(2) - K @ [[1.0, 0.0]]) @ predict
    system = control.ss(A, K, A[:1], K[:1], T_s)
    theta = np.array([1e-3, 0.03, 0.4, 3.0])
    found = filter_response(FILTERED.force_filter, jnp.exp(-1j * theta))
    np.testing.assert_allclose(found, system(np.exp(1j * theta)), rtol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("K_s", [375.0, 1900.0])
def test_margins_with_a_filter_of_the_force_are_the_gains_that_the_law_bears(K_s: float) -> None:
    """Cut at a, the gain of both hold integrals is that of the whole loop; the matrix is the running law's own."""
    params = Params.published("cautious")
    gains = design(params, force_filter=FILTERED.force_filter)
    contact = contact_of(K_s, params.K2, FILTERED)

    @jax.jit
    def found(cut: float) -> Any:
        return loop_margins(*[lambda theta, late=None: loop_response(gains, contact, theta, cut, late)] * 2, T_S)

    at_a = found(1.0)
    for decibels in (float(at_a.gain_margin_db), -float(at_a.gain_reduction_db)):
        scaled = contact._replace(gamma=tuple(10.0 ** (decibels / 20.0) * each for each in contact.gamma))
        assert radius(np.asarray(closed_loop_matrix(gains, scaled))) == pytest.approx(1.0, abs=1e-6)
    judged = margins(params, K_s, path=FILTERED)
    assert float(judged.M_s) == pytest.approx(max(float(at_a.M_s), float(found(0.0).M_s)), rel=1e-9)
    assert float(judged.M_s) > 1.05 * float(margins(params, K_s).M_s)


NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")


@pytest.mark.parametrize(
    ("ideal", "mode"),
    [
        pytest.param(False, "reverse", marks=pytest.mark.oracle),
        pytest.param(True, "reverse", marks=pytest.mark.oracle),
        pytest.param(False, "forward", marks=pytest.mark.oracle),
    ],
)
def test_gradient_of_every_margin_is_the_central_difference(ideal: bool, mode: str) -> None:
    point = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))

    @jax.jit
    def values(x: jax.Array) -> jax.Array:
        params = Params(**dict(zip(NAMES, jnp.exp(x), strict=True)))
        return jnp.stack(margins(params, 1500.0, ideal=ideal)[:6])

    jacobian = np.asarray({"forward": jax.jacfwd, "reverse": jax.jacrev}[mode](values)(point))
    step = 1e-5
    shifts = step * np.eye(len(point))
    difference = np.stack([(values(point + s) - values(point - s)) / (2 * step) for s in shifts], axis=1)
    for ours, expected in zip(jacobian, difference, strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())


def test_slopes_of_a_batch_of_loops_are_numbers() -> None:
    """Of all loops that are stable: programs of jax 0.10 and 0.11 lost half of them to a derivative of `jnp.min`."""
    point = jnp.log(jnp.array([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0]))
    points = point + 0.3 * np.random.default_rng(0).standard_normal((32, len(point)))

    def worst(x: jax.Array) -> jax.Array:
        return margins(Params(**dict(zip(NAMES, jnp.exp(x), strict=True))), np.array([375.0, 810.0, 1900.0])).M_s

    assert np.isfinite(jax.jit(jax.vmap(jax.jacfwd(worst)))(points)).all()


@pytest.mark.oracle
def test_unstable_loops_have_a_radius_with_a_gradient() -> None:
    """A tuner that starts there must be able to walk to stability."""
    slope = jax.grad(lambda k: margins(Params(Khat_s=k), 1900.0, ideal=True).spectral_radius)(200.0)
    assert np.isfinite(slope)
    assert slope < 0.0


@pytest.mark.oracle
def test_batches_and_stiffness_sets_keep_their_shape() -> None:
    batch = Params.stack([Params(), Params(Q_p=2.0), Params.published("printed")])
    found = margins(batch, np.array([375.0, 810.0, 1900.0]), ideal=True)
    assert found.M_s.shape == (3, 3)
    assert found.status.tolist() == [[Status.OK] * 3, [Status.OK] * 3, [Status.OK, Status.OK, Status.UNSTABLE]]
    np.testing.assert_array_equal(np.asarray(found.spectral_radius) < 1.0, found.status == Status.OK)
    alone = margins(Params(Q_p=2.0), np.array([375.0, 810.0, 1900.0]), ideal=True)
    np.testing.assert_allclose(found.M_s[1], alone.M_s, rtol=1e-9)


@pytest.mark.parametrize(("stiffness", "delay"), [(0.0, 1), (-5.0, 1), (float("nan"), 1), (810.0, 3)])
def test_impossible_tissue_or_delay_is_refused(stiffness: float, delay: int) -> None:
    with pytest.raises(InputError, match="must be"):
        margins(Params(), stiffness, delay=delay)


@pytest.mark.oracle
@pytest.mark.parametrize("ideal", [False, True])
def test_loops_of_any_number_as_they_run_and_ideal_are_judged_by_one_program(ideal: bool) -> None:
    """One for just these loops says the same of each; they are one more than a block holds, of two controllers."""
    stiffness = np.geomspace(375.0, 1900.0, CELLS // 2 + 1)[:, None]
    both = Params.stack([Params(), TUNED])
    margins(Params(), 810.0)
    programs = stability._block.programs
    found = margins(both, stiffness, ideal=ideal)
    assert stability._block.programs == programs
    assert found.M_s.shape == (2, *stiffness.shape)
    alone = jax.jit(lambda params: margins(params, stiffness, ideal=ideal))(both)
    for name, values in alone._asdict().items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-9, err_msg=name)
