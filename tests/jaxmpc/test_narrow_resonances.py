"""Margins at resonances that are narrower than the first search is fine."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, Timing, design, margins
from jaxmpc.stability.crossings import loop_margins
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.world.loop_path import loop_path
from tests.jaxmpc.judged_loops import SENSOR, T_S, cut_margins, radius

pytestmark = pytest.mark.once

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


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s"), NARROW)
def test_delay_margin_at_a_narrow_resonance(independent_loop: Callable[..., Any], params: Params, K_s: float) -> None:
    assert check_delay_margin(independent_loop, design(params), params, K_s, 0.25)


@pytest.mark.oracle
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


QUICK = [
    (
        Params(architecture="mpc", lam=7.89e-12, Q_p=3.26e5, T_cl=4.78e-3, K2=4.49, Khat_s=1062.8, Hp=55, Hu=8),
        174.43,
        1,
    ),
    (Params(architecture="aob", Q_p=2.63e7, T_cl=1.57e-2, K2=10.0, Khat_s=2607.0), 2219.1, 2),
    (Params(architecture="aob", Q_p=9.78e7, Q_x=0.0, T_cl=2.58e-2, K2=0.1, Khat_s=1317.5), 1121.5, 2),
]
"""Loops that cross over near the Nyquist frequency, of 0.97, 0.021 and 0.057 samples more: 1.8, 0.002 and 0.042 were
told, and of a loop like the first at 45 ms a negative one."""


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay"), QUICK)
def test_delay_margin_near_the_nyquist_frequency(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int
) -> None:
    """Where most of what a fraction of a sample does is what sampling folds down."""
    velocity, gains = 1350.0, design(params)
    path = loop_path(T_S, delay, velocity_cutoff=velocity, lowpass_hz=0.0)
    found = float(margins(params, K_s, path=path).delay_margin_s) / T_S

    def worst(late: float) -> float:
        loops = (
            independent_loop(gains, K_s, float(params.K2), delay, False, 0.0, velocity, **{place: late})[0]
            for place in ("late_v", "late_a")
        )
        # An active state that MPC alone has not is no mode of its loop.
        idle = [2 + params.designed_delay] if params.architecture == "mpc" else []
        return max(radius(np.delete(np.delete(A, idle, 0), idle, 1)) for A in loops)

    assert all(worst(late) < 1.0 for late in np.linspace(0.0, 0.99 * found, 20))
    assert worst(found) == pytest.approx(1.0, abs=1e-6)


def test_a_resonance_far_outside_the_unit_circle_hides_no_gain_margin() -> None:
    """Between two angles searched the loop crosses the real axis near −100: a straight line took that for −0.5."""
    params = Params(lam=9.3744e-6, Q_p=0.020647, T_cl=1.0635866e-3, K2=0.0, Khat_s=111.618, Hp=60, Hu=2)
    K_s, path = 273.131, loop_path(3.3220350e-4, 2, velocity_cutoff=30.0, lowpass_hz=0.0)
    gains = jax.tree.map(np.asarray, design(params, Timing(path.T_s)))
    contact = jax.tree.map(np.asarray, contact_of(K_s, params.K2, path))
    response = np.asarray(loop_response(gains, contact, np.geomspace(1e-3, np.pi, 60_000), 1.0))
    level = -response.real[:-2][response.imag[:-2] * response.imag[1:-1] < 0.0]
    decibels = -20.0 * np.log10(level[level > 0.0])
    assert decibels.min() < -30.0
    found = margins(params, K_s, path=path)
    assert float(found.gain_margin_db) == pytest.approx(decibels[decibels > 0.0].min(), rel=2e-3)
    assert float(found.gain_reduction_db) == pytest.approx(-decibels[decibels < 0.0].max(), rel=2e-3)


@pytest.mark.parametrize("gain", [0.5, 0.9])
def test_a_loop_that_meets_the_real_axis_at_the_nyquist_frequency_alone(gain: float) -> None:
    """A gain behind a sample of delay, L = g q: 1 + L is least, and −L largest, at q = −1."""

    def loop(theta: Any, late: Any = 0.0) -> Any:
        return gain * jnp.exp(-1j * theta * (1.0 + (0.0 if late is None else late)))

    found = jax.jit(lambda: loop_margins(loop, loop, T_S))()
    assert float(found.M_s) == pytest.approx(1.0 / (1.0 - gain), rel=1e-9)
    assert float(found.gain_margin_db) == pytest.approx(-20.0 * np.log10(gain), rel=1e-9)
    assert np.isinf([found.gain_reduction_db, found.phase_margin_deg, found.delay_margin_s]).all()
