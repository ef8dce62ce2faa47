"""Where in its beat the heart is, and how strong the beat: phase and gain from the onsets, in continuous time."""

import numpy as np

from jaxmpc.world.heart.harmonics import fade_in, fade_in_rate

NOMINAL_CYCLE = 1.0 / 1.265
"""Cycle of the harmonic table, the comb through the peaks of the paper's Fig. 4 [s]."""
SYSTOLE = 0.4
"""Part of the table's cycle that its stroke and return take [cycles]."""
LONGEST_SYSTOLE = 0.5
"""Part of a short cycle that systole takes at most (chosen here) [-]."""
GAIN_BLEND = 0.3
"""Last part of a cycle, near rest, in which the gain goes over to the next beat's [cycles]."""


def cardiac_phase(onsets: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phase that is k at the k-th onset, increasing, with continuous first and second derivative.

    A long beat is mostly a long diastole: systole grows with √RR (Bazett's law of the QT interval), so a
    stroke after a pause is hardly slower and one in tachycardia hardly faster. In short beats it takes half of the
    cycle at most, or the phase, which must end every cycle, would rush through diastole.
    At RR = 1/1.265 s the phase is linear.

    Between its knots (onset and end of systole of each beat) the phase is the quintic with zero second derivative
    at both ends. It increases because no end's slope exceeds 1.2 times the mean one.

    Args:
        onsets: Beat onsets, two past the last time at least, shape (beats,) [s].
        t: Times from `onsets[0]`, shape (n,) [s].

    Returns:
        Phase, shape (n,) [cycles], and its rate, shape (n,) [cycles/s].
    """
    cycle = np.diff(onsets)
    systole = np.minimum(SYSTOLE * np.sqrt(cycle * NOMINAL_CYCLE), LONGEST_SYSTOLE * cycle)
    knots = np.stack([onsets[:-1], onsets[:-1] + systole], axis=1).ravel()
    phases = (np.arange(len(cycle))[:, None] + [0.0, SYSTOLE]).ravel()
    width, advance = np.diff(knots), np.diff(phases)
    mean = advance / width
    slopes = (phases[2:] - phases[:-2]) / (knots[2:] - knots[:-2])
    # The derivative's Bernstein coefficients are mean · (a, a, 5 − 2a − 2b, b, b) with a, b = end slopes / mean;
    # a + b < 2.5 keeps them all positive.
    slopes = np.minimum(slopes, 1.2 * np.minimum(mean[:-1], mean[1:]))
    slopes = np.concatenate([mean[:1], slopes, mean[-1:]])
    i = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(width) - 1)
    s, a, b = (t - knots[i]) / width[i], slopes[i] / mean[i], slopes[i + 1] / mean[i]
    rest = 1.0 - s
    rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    phase = rise + a * s * rest**3 * (1.0 + 3.0 * s) - b * s**3 * rest * (4.0 - 3.0 * s)
    bernstein = (
        a * rest**3 * (rest + 4.0 * s),
        6.0 * (5.0 - 2.0 * (a + b)) * (s * rest) ** 2,
        b * s**3 * (4.0 - 3.0 * s),
    )
    return phases[i] + advance[i] * phase, mean[i] * sum(bernstein)


def beat_gain(gain: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gain of the displacement at a cardiac phase, blended from beat to beat while the heart is near rest.

    Args:
        gain: Gain of each beat, shape (beats,) [-].
        phase: Cardiac phase, shape (n,) [cycles].

    Returns:
        Gain, shape (n,) [-], and its derivative by the phase, shape (n,) [1/cycle].
    """
    beat = np.maximum(np.rint(phase + 0.5 * GAIN_BLEND).astype(int), 0)
    before, change = gain[np.maximum(beat - 1, 0)], gain[beat] - gain[np.maximum(beat - 1, 0)]
    since = phase - beat
    blend = fade_in(since, -GAIN_BLEND, GAIN_BLEND)
    return before + change * blend, change * fade_in_rate(since, -GAIN_BLEND, GAIN_BLEND)
