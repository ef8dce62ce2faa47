"""What is heard of the tissue, sample by sample, against scipy's filters: the lock-in, its interval, and the watch."""

import math

import jax
import numpy as np
import pytest
from scipy.signal import lfilter

from jaxmpc import Params
from jaxmpc.law import identification
from jaxmpc.law.credit import FELT
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.stiffness import SILENT, Alarm, StiffnessEstimate, StiffnessIdentification, unknown
from jaxmpc.synthesis.listening import Listening

STIFFNESS, SAMPLES = 810.0, 1500


def constants_at(T_s: float) -> StiffnessIdentification:
    listening = Params.published("family").listening
    assert isinstance(listening, Listening)
    return StiffnessIdentification(*jax.tree.map(float, listening.constants(T_s)))


def heard(
    constants: StiffnessIdentification, y: np.ndarray, x: np.ndarray, alarm: Alarm = SILENT, **held: float
) -> list[StiffnessEstimate]:
    """States of an axis whose sine sounds, unless what is held says otherwise, and which decides nothing."""
    state, states = unknown(constants, float(y[0])), []
    state = state._replace(last=(float(y[0]), float(x[0])))
    for force, tip in zip(y.tolist(), x.tolist(), strict=True):
        state = state._replace(**{"listening": 1.0, "authority": 0.0, "strain": 0.0, **held})
        state = identification.step(constants, state, force, tip, 0.0, 0.0, alarm, FLOATS)
        states.append(state)
    return states


def movement(T_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] and tip [m] of a spring, with the sine, a heart and noise in them."""
    rng, t = np.random.default_rng(3), T_s * np.arange(SAMPLES)
    x = 1e-4 * np.sin(2.0 * np.pi * 17.0 * t) + 1e-3 * np.sin(2.0 * np.pi * 1.3 * t)
    return STIFFNESS * x - 5.0 + rng.normal(0.0, 0.01, SAMPLES), x


def low_pass(share: float, values: np.ndarray) -> np.ndarray:
    return np.asarray(lfilter([share], [1.0, share - 1.0], values))


@pytest.mark.parametrize("T_s", [1e-3, 4e-3])
def test_what_the_lock_in_hears_is_what_the_equations_say(T_s: float) -> None:
    constants = constants_at(T_s)
    y, x = movement(T_s)
    mixer = np.exp(-2j * np.pi * 17.0 * T_s * np.arange(1, SAMPLES + 1))
    passed = []
    for signal in (y, x):
        once = low_pass(constants.mixing, np.diff(signal, prepend=signal[0]) * mixer)
        twice = low_pass(constants.mixing, once)
        passed.append((twice, low_pass(constants.mixing, twice)))
    (Y2, Y), (X2, X) = passed
    K = np.real(Y * X.conj()) / (np.abs(X) ** 2 + identification.TIP_FLOOR)
    rest = low_pass(constants.averaging, np.abs(Y2 - Y - K * (X2 - X)) ** 2)
    filled = low_pass(constants.averaging, np.ones(SAMPLES))
    floor = identification.FORCE_FLOOR
    width = constants.confidence * np.sqrt(1.5 * (rest + floor) / (filled * np.abs(Y) ** 2 + floor))
    states = heard(constants, y, x)
    np.testing.assert_allclose([complex(*state.force[-1]) for state in states], Y, rtol=0, atol=1e-12)
    np.testing.assert_allclose([complex(*state.tip[-1]) for state in states], X, rtol=0, atol=1e-15)
    np.testing.assert_allclose([state.rest for state in states], rest, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose([state.heard for state in states], filled, rtol=1e-9)
    np.testing.assert_allclose([state.width for state in states], np.minimum(width, 10.0), rtol=1e-6)
    assert states[-1].width < constants.band
    silent = heard(constants, y, x, listening=0.0)
    assert all(state.force[-1] == (0.0, 0.0) == state.tip[-1] for state in silent)


@pytest.mark.parametrize("T_s", [1e-3, 4e-3])
def test_the_answer_is_what_of_the_force_is_at_the_sine(T_s: float) -> None:
    """Both halves of the spectrum: a force of nothing but the sine is taken away whole, whatever its phase."""
    constants, lag = constants_at(T_s), 0.7
    seconds = 6.0
    y = 0.14 * np.sin(2.0 * np.pi * 17.0 * T_s * np.arange(1, round(seconds / T_s) + 1) - lag)
    states = heard(constants, y, y / STIFFNESS)[-100:]
    told = [identification.answer(constants, state) for state in states]
    np.testing.assert_allclose(told, y[-100:], rtol=0, atol=1e-3)
    assert states[-1].upset < 1e-6
    assert identification.dither(constants, states[-1]) == pytest.approx(
        0.14 * math.sin(2.0 * math.pi * 17.0 * seconds)
    )


def unpredicted(constants: StiffnessIdentification, y: np.ndarray) -> np.ndarray:
    """What a filter of second order with all its poles at one place does not predict: ((1 − q)/(1 − p q))³."""
    pole = 1.0 - constants.prediction[2] ** (1.0 / 3.0) * constants.T_s ** (2.0 / 3.0)
    error = y - y[0]
    for _ in range(3):
        error = np.asarray(lfilter([1.0, -1.0], [1.0, -pole], error))
    return error


@pytest.mark.parametrize("T_s", [1e-3, 4e-3])
@pytest.mark.parametrize(("strain", "authority", "faster"), [(0.0, 0.0, 1.0), (2.0, 0.0, 21.0), (2.0, 0.5, 11.0)])
@pytest.mark.parametrize("shared", [False, True])
def test_the_watch_hears_what_the_past_does_not_predict(
    T_s: float, strain: float, authority: float, faster: float, shared: bool
) -> None:
    """After a push, its own or another axis's, that took the control, it forgets 21 times as fast."""
    constants = constants_at(T_s)
    y, x = movement(T_s)
    push = strain * FELT**2
    alarm, own = (Alarm(0.0, push), 0.0) if shared else (SILENT, push)
    states = heard(constants, y, x, alarm, authority=authority, strain=own)
    squares = unpredicted(constants, y) ** 2
    share = min(constants.watching * faster, 0.5)
    np.testing.assert_allclose([state.noise for state in states], low_pass(share, squares), rtol=1e-6)
    of_burst = low_pass(T_s / identification.BURST, squares)
    np.testing.assert_allclose([state.burst for state in states], of_burst, rtol=1e-6)


def test_no_watch_forgets_more_than_half_in_a_sample() -> None:
    constants = constants_at(4e-3)._replace(watching=0.2)
    y, x = movement(4e-3)
    states = heard(constants, y, x, strain=2.0 * FELT**2)
    expected = low_pass(0.5, unpredicted(constants, y) ** 2)
    np.testing.assert_allclose([state.noise for state in states], expected, rtol=1e-6)


def test_the_error_is_remembered_for_a_tenth_and_for_a_second() -> None:
    """The error of a still force of 0.3 N too much, without a sine."""
    constants = constants_at(1e-3)
    state = unknown(constants, 0.3)
    for _ in range(100):
        state = identification.step(constants, state, 0.3, 0.0, 0.0, 0.0, SILENT, FLOATS)
    assert state.upset == pytest.approx(0.09 * (1.0 - 0.99**100))
    assert state.strain == pytest.approx(0.09 * (1.0 - 0.999**100))


def test_the_sine_keeps_its_size_for_hours() -> None:
    """A rotation that a rounding has made too large or too small is back on the unit circle within some samples."""
    constants = constants_at(1e-3)
    for size in (0.9, 1.1):
        state = unknown(constants, 0.0)._replace(wave=(size, 0.0))
        for _ in range(6):
            state = identification.step(constants, state, 0.0, 0.0, 0.0, 0.0, SILENT, FLOATS)
        assert math.hypot(*state.wave) == pytest.approx(1.0, abs=1e-12)
