"""The heart as the robot feels it: disturbance from two runs, its spectrum, and the peaks in it.

The paper's Fig. 3a and Fig. 4. All of it comes from what the robot measures, tip and force; no heart motion goes in.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxmpc.files.errors import InputError

RECORD = 20.0
"""Length of the paper's record [s]; its spectrum has bins of 0.05 Hz."""
LOWEST_PEAK, HIGHEST_PEAK = 0.2, 10.0
"""Where peaks are looked for [Hz]: from 12 breaths a minute, below which wander is not told from a line, to well
beyond the paper's last peak at 6.32."""
PROMINENCE_DB = 15.0
"""How far a peak stands out of its neighbourhood; in 20 s of white noise one record in a thousand has such a line."""
RANGE_DB = 40.0
"""How far below the strongest a peak may be: a hundredth of its amplitude."""
_NEIGHBOURHOOD = 20
"""Bins to either side whose median is the floor that a peak stands on: 1 Hz in the paper's record."""
_WANDER = 0.75
"""How far the true frequency may be from the bin of its maximum [bins]; two peaks never meet."""
_ITERATIONS = 50
"""Steps of the fit at most; a few are enough, since it begins within a bin."""


class PowerSpectrum(NamedTuple):
    """Power spectral density of a record."""

    frequency: np.ndarray
    """Frequencies of the bins, shape (bins,) [Hz]."""
    density: np.ndarray
    """Per axis, one-sided, shape (axes, bins) [N²/Hz]."""


class Peaks(NamedTuple):
    """The lines of a disturbance, by rising frequency."""

    frequency: np.ndarray
    """Shape (peaks,) [Hz]."""
    force: np.ndarray
    """Amplitude, zero to peak, shape (axes, peaks) [N]."""
    motion: np.ndarray
    """The same as motion of the heart, shape (axes, peaks) [mm]."""


def disturbance(stiffness: float, tip_on: Any, tip_off: Any, force_on: Any, force_ref: Any) -> np.ndarray:
    """Force that the moving heart would exert on a tip at rest: d = K_s (x_on − x_off) + (F_d − y_on).

    The first term is what the tip did about the motion, the second what it left; together K_s x_heart, but for
    friction and noise of the run without motion.

    Args:
        stiffness: K_s of the tissue [N/m].
        tip_on: Displacement of the tip, heart moving, shape (axes, steps) [m].
        tip_off: The same, heart still, under the same reference [m].
        force_on: Measured force on the tissue, heart moving [N].
        force_ref: Wanted force of both runs [N].

    Returns:
        Disturbance, shape (axes, steps) [N].

    Raises:
        InputError: The shapes differ, or a sample is not finite.
    """
    signals = {"tip_on": tip_on, "tip_off": tip_off, "force_on": force_on, "force_ref": force_ref}
    on, off, force, wanted = (_signal(name, signal) for name, signal in signals.items())
    if len({signal.shape for signal in (on, off, force, wanted)}) != 1:
        found = f"{on.shape}, {off.shape}, {force.shape}, {wanted.shape}"
        raise InputError("tips and forces", found, "of one shape", "Record both runs with the same experiment.")
    found_force: np.ndarray = stiffness * (on - off) + (wanted - force)
    return found_force


def power_spectral_density(signal: Any, T_s: float) -> PowerSpectrum:
    """Spectrum of one record, mean removed, under a Hann window, not averaged: bins of 1/duration.

    Args:
        signal: Shape (axes, steps) [N].
        T_s: Sampling time [s].

    Raises:
        InputError: Not two-dimensional, or a sample is not finite.
    """
    from scipy.signal import periodogram

    return PowerSpectrum(*periodogram(_signal("signal", signal), 1.0 / T_s, "hann", detrend="constant"))


def peaks(signal: Any, T_s: float, stiffness: float) -> Peaks:
    """The lines of a disturbance between `LOWEST_PEAK` and `HIGHEST_PEAK`; none in noise.

    A line is a maximum of the power of all axes together that stands `PROMINENCE_DB` out of its neighbourhood. The
    frequencies are then moved off the bins, and the amplitudes found, by least squares over all lines and axes:

        d_i(t) ≈ c_i + Σ_k a_ik cos 2π f_k t + b_ik sin 2π f_k t,   amplitude √(a² + b²)

    Args:
        signal: Disturbance, shape (axes, steps) [N].
        T_s: Sampling time [s].
        stiffness: K_s of the tissue [N/m].

    Raises:
        InputError: Not two-dimensional, or a sample is not finite.
    """
    record = _signal("signal", signal)
    near = _maxima(power_spectral_density(record, T_s))
    if not len(near):
        return Peaks(near, np.zeros((len(record), 0)), np.zeros((len(record), 0)))
    t, bin_width = np.arange(record.shape[1]) * T_s, 1.0 / (record.shape[1] * T_s)

    # Lines end below 10 Hz: means of 10 ms hold all there is of them, in a tenth of the numbers.
    together = max(1, round(0.01 / T_s))
    whole = len(t) // together * together
    t = t[:whole].reshape(-1, together).mean(axis=1)
    means = record[:, :whole].reshape(len(record), -1, together).mean(axis=2)
    found, weights = _fitted(near, t, means.T, _WANDER * bin_width)
    count = len(found)
    # A mean lowers a wave a little, by sin(π f T) / π f T.
    force = np.hypot(weights[:count], weights[count : 2 * count]).T / np.sinc(found * together * T_s)
    return Peaks(found, force, 1e3 * force / stiffness)


def _fitted(near: np.ndarray, t: np.ndarray, record: np.ndarray, wander: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies near given ones, and weights (cos, sin, 1), that leave least of a record (samples, axes).

    Gauss-Newton in the frequencies alone, the weights being those of each frequency (Kaufman, BIT 15, 1975).
    """
    frequency, count = near, len(near)
    for _ in range(_ITERATIONS):
        angle = 2.0 * np.pi * np.outer(t, frequency)
        cosine, sine = np.cos(angle), np.sin(angle)
        waves = np.concatenate([cosine, sine, np.ones((len(t), 1))], axis=1)
        # The waves are nearly orthogonal, so normal equations lose nothing.
        inverse = np.linalg.inv(waves.T @ waves)
        weights = inverse @ (waves.T @ record)
        left = record - waves @ weights
        # What a frequency changes, per axis, but for what the weights would take back.
        per_phase = cosine[:, :, None] * weights[count : 2 * count] - sine[:, :, None] * weights[:count]
        turned = 2.0 * np.pi * t[:, None, None] * per_phase
        slopes = turned - np.tensordot(waves, np.tensordot(inverse @ waves.T, turned, 1), 1)
        step = np.linalg.lstsq(slopes.transpose(0, 2, 1).reshape(-1, count), left.ravel())[0]
        following = np.clip(frequency + step, near - wander, near + wander)
        moved, frequency = np.abs(following - frequency).max(), following
        if moved < 1e-6 * wander:
            break
    return frequency, weights


def _maxima(spectrum: PowerSpectrum) -> np.ndarray:
    """Frequencies of the bins where a line stands out [Hz]."""
    from scipy.ndimage import median_filter
    from scipy.signal import find_peaks

    power = spectrum.density.sum(axis=0)
    level = 10.0 * np.log10(np.maximum(power, np.finfo(float).tiny))
    # A single record's noise has bins of almost no power: measured from those, every maximum would be prominent.
    level = np.maximum(level, median_filter(level, 2 * _NEIGHBOURHOOD + 1, mode="reflect"))
    (bins, _) = find_peaks(level, height=level.max() - RANGE_DB, prominence=PROMINENCE_DB)
    found = spectrum.frequency[bins]
    lines: np.ndarray = found[(found > LOWEST_PEAK - 1e-9) & (found < HIGHEST_PEAK)]
    return lines


def _signal(key: str, value: Any) -> np.ndarray:
    signal = np.asarray(value, np.float64)
    if signal.ndim != 2 or signal.shape[1] < 2 * _NEIGHBOURHOOD:
        remedy = "One row an axis, one column a sample."
        raise InputError(key, f"an array of shape {signal.shape}", f"(axes, at least {2 * _NEIGHBOURHOOD})", remedy)
    if not np.isfinite(signal).all():
        raise InputError(key, "nan or inf", "finite", "Leave out runs that diverged.")
    return signal
