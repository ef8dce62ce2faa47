"""Disturbance and its peaks: known lines come back, noise has none, and the arm's heart is found from tip and force."""

from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.ndimage
import scipy.optimize
import scipy.signal

from jaxmpc import Experiment, InputError, Params, evaluate
from jaxmpc.cli.simulate import without_motion
from jaxmpc.spectra.disturbance import RECORD, disturbance, peaks, power_spectral_density
from jaxmpc.world.heart.harmonics import AMPLITUDES_MM, HARMONICS_HZ, harmonic_motion

T_S = 1e-3
T = np.arange(round(RECORD / T_S)) * T_S
PAPER_HZ = [0.34, 0.72, 1.25, 2.53, 3.78, 5.08, 6.32]
BIN = 0.05


def noise(seed: int, axes: int = 3, size: float = 1.0) -> np.ndarray:
    drawn: np.ndarray = size * np.random.default_rng(seed).standard_normal((axes, len(T)))
    return drawn


@pytest.mark.parametrize("seed", range(4))
def test_known_lines_come_back(seed: int) -> None:
    """Any phases, off the bins, under noise as large as the smallest line: 1e-3 Hz and 5 %."""
    random = np.random.default_rng(seed)
    frequencies = np.sort(random.uniform(0.5, 1.1, 5) + np.arange(5) * 1.7)
    amplitudes = random.uniform(0.1, 1.0, (3, 5))
    phases = random.uniform(0.0, 2.0 * np.pi, (3, 5))
    lines = np.einsum("ak,akt->at", amplitudes, np.cos(2.0 * np.pi * frequencies[:, None] * T + phases[..., None]))
    found = peaks(7.0 + lines + noise(seed, size=0.1), T_S, 500.0)
    np.testing.assert_allclose(found.frequency, frequencies, atol=1e-3)
    np.testing.assert_allclose(found.force, amplitudes, rtol=0.05, atol=3e-3)
    np.testing.assert_allclose(found.motion, 1e3 * found.force / 500.0, rtol=1e-12)


def test_the_papers_peaks_come_out_of_the_heart_itself() -> None:
    for seed in (None, 1, 2):
        found = peaks(810.0 * harmonic_motion(T, phase_seed=seed).T, T_S, 810.0)
        np.testing.assert_allclose(found.frequency, PAPER_HZ, atol=1e-3)
        np.testing.assert_allclose(found.motion, AMPLITUDES_MM, rtol=1e-2)


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("pole", [0.0, 0.99])
def test_noise_has_no_peaks(axes: int, pole: float) -> None:
    """White, and with most of its power below the lowest peak looked for."""
    for seed in range(30):
        coloured = scipy.signal.lfilter([1.0], [1.0, -pole], noise(seed, axes))
        assert len(peaks(coloured, T_S, 810.0).frequency) == 0


def test_one_weak_line_in_noise_is_told_from_it() -> None:
    """The counterpart of the test above: the same noise and a line of a fifth of its RMS."""
    for seed in range(10):
        found = peaks(noise(seed) + 0.2 * np.cos(2.0 * np.pi * 3.21 * T), T_S, 810.0)
        np.testing.assert_allclose(found.frequency, [3.21], atol=0.02)


@pytest.mark.parametrize("steps", [1000, 1001])
def test_density_adds_up_to_the_power_of_a_line(steps: int) -> None:
    """A line on a bin, of amplitude A, has the power A²/2; a Hann window spreads it over three bins."""
    width = 1.0 / (steps * T_S)
    signal = 3.0 + 0.7 * np.cos(2.0 * np.pi * 12.0 * width * np.arange(steps) * T_S + 0.4)[None]
    spectrum = power_spectral_density(signal, T_S)
    np.testing.assert_allclose(spectrum.frequency, width * np.arange(steps // 2 + 1), rtol=1e-12)
    np.testing.assert_allclose(spectrum.density[0, 11:14].sum() * width, 0.5 * 0.7**2, rtol=1e-9)
    np.testing.assert_allclose(np.delete(spectrum.density[0], [11, 12, 13]), 0.0, atol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(3))
def test_peaks_are_scipys(seed: int) -> None:
    """Which lines there are, by scipy's peaks over scipy's median, and where, by its bounded least squares.

    Both fit means of 10 ms, and end within a ten-thousandth of a bin.
    """
    random = np.random.default_rng(100 + seed)
    frequencies, amplitudes = random.uniform(0.3, 9.5, 8), random.uniform(0.05, 1.0, (3, 8))
    phases = random.uniform(0.0, 2.0 * np.pi, (3, 8))
    lines = np.einsum("ak,akt->at", amplitudes, np.cos(2.0 * np.pi * frequencies[:, None] * T + phases[..., None]))
    signal = lines + noise(seed, size=0.3)
    frequency, density = scipy.signal.periodogram(signal, 1.0 / T_S, window="hann", detrend="constant")
    level = 10.0 * np.log10(density.sum(axis=0))
    level = np.maximum(level, scipy.ndimage.median_filter(level, 41, mode="reflect"))
    bins, _ = scipy.signal.find_peaks(level, prominence=15.0)
    near = frequency[[i for i in bins if 0.2 <= frequency[i] < 10.0 and level[i] > level.max() - 40.0]]

    t, means = T.reshape(-1, 10).mean(axis=1), signal.reshape(3, -1, 10).mean(axis=2).T

    def left_over(f: np.ndarray) -> np.ndarray:
        angle = 2.0 * np.pi * np.outer(t, f)
        waves = np.concatenate([np.cos(angle), np.sin(angle), np.ones((len(t), 1))], axis=1)
        left: np.ndarray = means - waves @ np.linalg.solve(waves.T @ waves, waves.T @ means)
        return left.ravel()

    bounds = (near - 0.75 * BIN, near + 0.75 * BIN)
    expected = scipy.optimize.least_squares(left_over, near, bounds=bounds, x_scale=BIN, xtol=1e-10).x
    np.testing.assert_allclose(peaks(signal, T_S, 810.0).frequency, expected, atol=1e-4 * BIN)


def test_spectrum_has_the_papers_bins_and_keeps_the_power() -> None:
    signal = noise(0)
    spectrum = power_spectral_density(signal, T_S)
    np.testing.assert_allclose(np.diff(spectrum.frequency), BIN, rtol=1e-9)
    np.testing.assert_allclose(spectrum.density.sum(axis=1) * BIN, signal.var(axis=1), rtol=0.05)


def test_disturbance_of_an_ideal_pair_of_runs_is_stiffness_times_heart() -> None:
    """y = K_s (x_tip − x_heart) in both runs, whatever the tip does about the motion."""
    heart, wanted = harmonic_motion(T).T, np.array([0.0, 0.0, -5.0])[:, None] + 0.0 * T
    tip_off = wanted / 600.0
    tip_on = tip_off + 0.9 * heart
    force_on = 600.0 * (tip_on - heart)
    found = disturbance(600.0, tip_on, tip_off, force_on, wanted)
    np.testing.assert_allclose(found, 600.0 * heart, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tip_off": np.zeros((3, 99))}, ["tips and forces", "(3, 99)", "of one shape"]),
        ({"force_on": np.full((3, 100), np.nan)}, ["force_on", "finite", "diverged"]),
        ({"tip_on": np.zeros(100)}, ["tip_on", "(100,)", "(axes"]),
    ],
)
def test_wrong_signals_are_named(change: dict[str, Any], words: list[str]) -> None:
    signals = {name: np.zeros((3, 100)) for name in ("tip_on", "tip_off", "force_on", "force_ref")} | change
    with pytest.raises(InputError) as caught:
        disturbance(810.0, **signals)
    for word in words:
        assert word in str(caught.value)


def found_by_simulation(experiment: Experiment) -> Any:
    """Peaks from the two runs' tips and forces alone, at a single stiffness."""
    (stiffness,) = experiment.stiffness
    on, off = (evaluate(Params(), e, trace=True).trace for e in (experiment, without_motion(experiment)))
    felt = disturbance(stiffness, on.tip[0], off.tip[0], on.force[0], on.force_ref[0, ..., 0])
    return peaks(felt[:, -len(T) :], T_S, stiffness)


def assert_is_the_calibrated_heart(found: Any) -> None:
    np.testing.assert_allclose(found.frequency, PAPER_HZ, atol=BIN)
    np.testing.assert_allclose(found.frequency, HARMONICS_HZ, atol=BIN)
    np.testing.assert_allclose(found.motion, AMPLITUDES_MM, rtol=0.1)
    np.testing.assert_allclose(found.force, 0.810 * AMPLITUDES_MM, rtol=0.1)


@pytest.mark.slow
def test_peaks_of_the_linear_loop() -> None:
    base = Experiment.published("table-1")
    assert_is_the_calibrated_heart(found_by_simulation(msgspec.structs.replace(base, stiffness=(810.0,))))


@pytest.fixture(scope="module")
def found_on_the_arm() -> Any:
    base = Experiment.published("table-1-wam")
    return found_by_simulation(msgspec.structs.replace(base, stiffness=(810.0,)))


@pytest.mark.slow
def test_peaks_on_the_arm(found_on_the_arm: Any) -> None:
    """With friction, encoders, noise and wrong masses: the paper's seven, and nothing else."""
    assert_is_the_calibrated_heart(found_on_the_arm)
