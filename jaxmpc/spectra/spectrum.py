"""What disturbs the loop in an experiment, as a few lines: heart, friction and model error, noise."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float

from jaxmpc.experiment import Experiment
from jaxmpc.spectra.input_disturbance import uncompensated_acceleration

LINES = 96
"""Lines that stand for a whole experiment: residuals within 1.5 % of all bins', efforts within 4 %, of loops with M_s
below 4 at sampling times from 0.25 to 4 ms."""
CROSSOVER = 150.0
"""Roughly where loops cross over, 24 Hz [rad/s]; only shares the lines out between frequencies. An angle in its place
missed by up to 7 % of the residual at 4 ms."""
TAPERED = 0.25
"""Part of the record that fades in and out: cut off sharply, its ends leak into every bin above the heart's."""


class Spectrum(NamedTuple):
    """Sum of lines of which each belongs to all axes; several may have the same angle. Arrays of float64."""

    theta: Float[np.ndarray, " lines"]
    """Angle θ = ω T_s [rad]."""
    heart: Complex[np.ndarray, "3 lines"]
    """Amplitude of the motion [m], zero to peak."""
    acceleration: Complex[np.ndarray, "3 lines"]
    """Amplitude of the disturbance acceleration at the command [m/s²]; its phase is against that of the heart."""
    noise: Float[np.ndarray, "3"]
    """Standard deviation of sensor noise and quantisation, white [N]."""

    @staticmethod
    def blank(lines: int = LINES) -> "Spectrum":
        """One of nothing, in the shapes and types that all have: programs can be compiled with it."""
        count = 2 * (lines // 2)
        amplitude = np.zeros((3, count), complex)
        return Spectrum(np.zeros(count), amplitude, amplitude, np.zeros(3))


@lru_cache(maxsize=32)  # before and after tuning, and in a job's problems, the scenarios are the same
def spectrum_of(experiment: Experiment, lines: int = LINES) -> Spectrum:
    r"""Heart, and on the arm friction and model error, from `settle` on; the reference counts as constant.

    Picking the strongest bins loses up to a quarter of an irregular rhythm's residual. Instead all bins are summed up
    in bands of equal share in the residual of a typical loop, so that a strong line keeps one to itself. In a band a
    loop differs from the typical one by a factor that hardly changes, and all that then counts of the answers x, w of
    the typical one to heart and acceleration are three sums over the bins, which two lines have as well:

        x₁ = √Σ|x|²,  w₁ = Σ x* w / x₁;   x₂ = 0,  w₂ = √(Σ|w|² − |w₁|²)

    Args:
        experiment: Its physics says whether the arm is in it.
        lines: Two per band; bands that stay empty make lines of no amplitude.
    """
    t = np.arange(experiment.steps) * experiment.sampling_time
    scored = t >= experiment.settle
    heart = _lines(experiment.signals.heart[scored])
    disturbed = experiment.physics != "linear"
    acceleration = _lines(uncompensated_acceleration(experiment)[scored]) if disturbed else np.zeros_like(heart)
    theta = 2.0 * np.pi * np.arange(1, heart.shape[1] + 1) / np.count_nonzero(scored)

    to_heart, to_acceleration = _typical(theta, experiment.sampling_time)
    x, w = heart * to_heart, acceleration * to_acceleration
    share = _share(x + w)
    bands = lines // 2
    band = np.minimum((np.cumsum(share) - 0.5 * share) * bands, bands - 1).astype(int)

    def summed(values: np.ndarray) -> np.ndarray:
        sums = np.zeros((bands, *values.shape[:-1]), values.dtype)
        np.add.at(sums, band, values.T)
        return sums.T

    total = summed(share)
    at = np.where(total > 0.0, summed(share * theta) / np.where(total > 0.0, total, 1.0), np.pi)
    x_1 = np.sqrt(summed(np.abs(x) ** 2))
    w_1 = summed(x.conj() * w) / np.where(x_1 > 0.0, x_1, 1.0)
    w_2 = np.sqrt(np.maximum(summed(np.abs(w) ** 2) - np.abs(w_1) ** 2, 0.0))
    to_heart, to_acceleration = _typical(at, experiment.sampling_time)
    noise = np.sqrt(experiment.sensor.noise**2 + np.array(experiment.sensor.lsb) ** 2 / 12.0)
    return Spectrum(
        np.tile(at, 2),
        np.hstack([x_1, 0.0 * x_1]) / np.tile(to_heart, 2) + 0.0j,
        np.hstack([w_1, w_2]) / np.tile(to_acceleration, 2),
        noise,
    )


def stacked(spectra: Sequence[Spectrum]) -> Spectrum:
    """Several as one, each field with a first dimension for them."""
    found: Spectrum = jax.tree.map(lambda *leaves: np.stack(leaves), *spectra)
    return found


def _lines(record: Float[np.ndarray, "steps 3"]) -> Complex[np.ndarray, "3 bins"]:
    """Amplitudes of a record's bins between zero and the Nyquist frequency, with the power of the record."""
    from scipy.signal.windows import tukey

    steps = len(record)
    window = tukey(steps, TAPERED, sym=False)
    window /= np.sqrt(np.mean(window**2))
    centred = record - window @ record / window.sum()
    bins: np.ndarray = 2.0 / steps * np.fft.rfft(centred * window[:, None], axis=0)[1 : (steps + 1) // 2].T
    return bins


def _typical(theta: Float[np.ndarray, " n"], T_s: float) -> tuple[Any, Any]:
    """How a typical loop answers heart and acceleration, but for a common factor.

    What the tip needs is w − ẍ. Below its crossover an integrating loop leaves of that a part in proportion to θ,
    above it as much as the tip alone, 1/θ².
    """
    answer = theta / (1.0 + (theta / (CROSSOVER * T_s)) ** 2) ** 1.5
    return (theta / T_s) ** 2 * answer, answer


def _share(answer: Complex[np.ndarray, "3 bins"]) -> Float[np.ndarray, " bins"]:
    """Share of each bin in the power of all axes, each axis weighing the same."""
    power = np.abs(answer) ** 2
    whole = power.sum(axis=1, keepdims=True)
    shares = (power / np.where(whole > 0.0, whole, 1.0)).sum(axis=0)
    share: np.ndarray = shares / max(float(shares.sum()), 1e-300)
    return share
