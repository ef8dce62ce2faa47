"""The guard of the loop's gain: against scipy's filters, the response in closed form, and on arms with soft cables."""

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from jaxmpc import Experiment, InputError, Params, design
from jaxmpc.law import gain_backoff
from jaxmpc.law.cascade import with_gain
from jaxmpc.stability.response import controller_response
from jaxmpc.xla.precision import in_float64
from tuning.trials import HARD, Job, run

T_S = 1e-3
GUARD = gain_backoff.constants(T_S, math)


def swinging(seconds: float = 0.8) -> np.ndarray:
    """An error that follows a heart slowly, with a swing that grows and dies away, (samples, 3) [N]."""
    t = np.arange(round(seconds / T_S)) * T_S
    swell = np.exp(-(((t - 0.3) / 0.1) ** 2)) * np.sin(2.0 * np.pi * 35.0 * t)
    slow = np.sin(2.0 * np.pi * 1.2 * t)
    return np.stack([0.2 * slow + swell, 0.1 * slow - 0.5 * swell, 0.3 * slow + 0.2 * swell], 1)


def gains_over(error: np.ndarray) -> np.ndarray:
    """g after every sample."""
    state, found = gain_backoff.init(), []
    for sample in error:
        state = gain_backoff.step(GUARD, state, tuple(sample))
        found.append(state.gain)
    return np.array(found)


def test_the_gain_is_that_of_scipys_filters() -> None:
    """The formulas of the module over two low-passes P = (1 − p)/(1 − p z⁻¹) and two high-passes 1 − P by scipy."""
    error = swinging()
    p = math.exp(-gain_backoff.CORNER * T_S)
    alpha = 1.0 - math.exp(-T_S / gain_backoff.MEMORY)

    def mean_square(numerator: list[float]) -> np.ndarray:
        twice = scipy.signal.lfilter(np.polymul(numerator, numerator), np.polymul([1.0, -p], [1.0, -p]), error, axis=0)
        found: np.ndarray = scipy.signal.lfilter([alpha], [1.0, alpha - 1.0], np.sum(twice**2, axis=1))
        return found

    g, expected = 1.0, []
    for e in (mean_square([p, -p]) / (gain_backoff.LIMIT**2 + mean_square([1.0 - p]))) ** 4:
        fall = gain_backoff.PACE * T_S * e / (1.0 + e)
        g = gain_backoff.LEAST + (g - gain_backoff.LEAST) * (1.0 - fall) + T_S / gain_backoff.RETURN * (1.0 - g)
        expected.append(g)
    found = gains_over(error)
    assert found.min() < 0.5, "the swing acts"
    # The same sums in another order: a difference of poles near 1 costs scipy's filter some digits.
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize(("size", "least"), [(0.5, 0.999), (20.0, 0.9)], ids=["followed", "not followed"])
def test_a_heart_alone_leaves_the_gain(size: float, least: float) -> None:
    """Harmonics up to 8 Hz, as large as where nothing follows the heart, and more noise than the sensor's."""
    t = np.arange(4000)[:, None] * T_S + np.array([0.0, 0.1, 0.35])
    heart = sum(np.sin(2.0 * np.pi * f * t) / n**2 for n, f in enumerate((1.25, 2.5, 5.0, 8.0), 1))
    noise = 0.03 * np.random.default_rng(0).standard_normal((4000, 3))
    swell = np.sin(np.linspace(0.0, 0.5 * np.pi, 4000))[:, None]
    assert gains_over(size * swell * heart + noise).min() > least


def test_what_runs_away_gives_a_number() -> None:
    assert gains_over(1e9 * swinging(0.2)).min() >= gain_backoff.LEAST


@in_float64
def test_its_slope_is_that_of_central_differences() -> None:
    error = jnp.asarray(swinging(0.4))

    def last(size: jax.Array) -> jax.Array:
        def one(state: gain_backoff.BackoffState, sample: jax.Array) -> tuple[gain_backoff.BackoffState, None]:
            return gain_backoff.step(GUARD, state, tuple(size * sample)), None

        start = jax.tree.map(jnp.asarray, gain_backoff.init(0.0 * size))
        return jax.lax.scan(one, start, error)[0].gain

    slope, step = float(jax.grad(last)(jnp.asarray(0.4))), 1e-5
    difference = (float(last(jnp.asarray(0.4 + step))) - float(last(jnp.asarray(0.4 - step)))) / (2.0 * step)
    assert slope < -0.1
    # Truncation step² g′″/6 with slopes that change over some 0.1: 1e-8 of them.
    assert slope == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("architecture", ["mpc-aob", "aob"])
@in_float64
def test_a_lower_gain_scales_the_controller_and_nothing_else(architecture: str, order: int) -> None:
    """V/Y in closed form, which other tests hold against a state-space model."""
    values = {"architecture": architecture, "disturbance_order": order, "Q_p": 10.0**-order}
    gains = jax.tree.map(jnp.asarray, design(Params.from_dict(values)))
    q = jnp.exp(-1j * jnp.geomspace(1e-3, 3.0, 50))
    whole = np.asarray(controller_response(gains, q))
    np.testing.assert_allclose(controller_response(with_gain(gains, 0.3), q), 0.3 * whole, rtol=1e-9)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"guarded": 1}, "guarded = 1: must be true or false"),
        ({"guarded": True, "architecture": "mpc"}, 'guarded = True: must be false with the architecture "mpc"'),
    ],
)
def test_a_guard_that_cannot_be_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        Params.from_dict(values)


@pytest.mark.slow
def test_it_holds_arms_whose_cables_swing() -> None:
    """The text design on 100 hard trials, some 60 of which it loses alone; the joints give whatever it asks for."""
    text = Params.published("text")
    guarded = Params.from_dict({**text.to_dict(), "guarded": True})
    lost = run(Job((text, guarded), Experiment.published("table-1-wam").without_limits(), HARD), 100).unstable
    assert 3 * lost[:, 1].sum() < lost[:, 0].sum()
    assert not (lost[:, 1] & ~lost[:, 0]).any(), "it loses none that stood without it"
