"""When the heart beats: beat onsets and the gain of each beat.

Everything random is drawn beat by beat from the seed, or is a sum of waves drawn once, so a longer run
extends a shorter one and never changes it, and the spacing of the times asked for changes nothing.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxmpc.world.heart.harmonics import fade_in
from jaxmpc.world.heart.rhythm_settings import RhythmSettings
from jaxmpc.world.heart.ventilation import respiratory_phase

WAVES_HZ, WAVES_WIDTH_HZ, LF_TO_HF = 0.1, 0.01, 0.5
"""ECGSYN's RR spectrum: Gaussian bands about 0.1 Hz (LF) and the respiratory rate (HF) (background knowledge)."""
WAVES_PER_BAND = 32
DRIFT_PERIOD = 120.0
"""Period of the slow drift of the heart rate: from one extreme to the other in 60 s [s]."""
RATE_STEP_DURATION = 3.0
"""Time in which the heart rate steps [s]."""
PREMATURE_PERIOD = (10, 20)
"""Beats from one premature beat, or from the last one of a burst, to the next [beats]."""
COUPLING = (0.45, 0.75)
"""Sinus onset to premature onset, over the sinus cycle: published 60 ± 15 % and 49 ± 22 % (Park 2015) [-]."""
PREMATURE_GAIN, NEXT_GAIN = (0.5, 0.8), (1.1, 1.3)
"""Displacement of a premature beat and of the potentiated one after it, over that of a sinus beat [-]."""
BURST = {"premature": (1, 1), "bigeminy": (4, 8)}
"""Premature beats in a row, every other beat being one [beats]."""
FIBRILLATION_CV = 0.2
"""Coefficient of variation of RR in atrial fibrillation [-]."""


class Beats(NamedTuple):
    """The beats of a run, a few past its end."""

    onsets: np.ndarray
    """Beginning of each systole, increasing from 0, shape (beats,) [s]."""
    gain: np.ndarray
    """Displacement over that of a sinus beat, shape (beats,) [-]."""


def generator(seed: int, stream: int) -> np.random.Generator:
    """Random numbers of one purpose, independent of the other purposes under the same seed."""
    return np.random.Generator(np.random.Philox([seed, stream]))


def beats(motion: RhythmSettings, until: float) -> Beats:
    """Beat onsets of `motion.rhythm` from 0 to beyond `until` [s]."""
    interval = _intervals(motion)
    onsets = [0.0]
    # Phase and gain at a time depend on the next beats too: two onsets, and one that a premature beat may move.
    while len(onsets) < 4 or onsets[-4] <= until:
        onsets.append(onsets[-1] + interval(onsets[-1]))
    sinus = Beats(np.array(onsets), np.ones(len(onsets)))
    if motion.rhythm not in BURST:
        return sinus
    return _with_premature_beats(sinus.onsets, BURST[motion.rhythm], generator(motion.seed, 2))


def _intervals(motion: RhythmSettings) -> Callable[[float], float]:
    """The RR interval [s] that begins at a time [s]; called once a beat, in order."""
    match motion.rhythm:
        case "variability":
            return _variable_intervals(motion)
        case "rate-step":
            before, after = motion.rate_step_hz
            at = motion.rate_step_at
            return lambda t: 1.0 / (before + (after - before) * float(fade_in(np.array(t), at, RATE_STEP_DURATION)))
        case "fibrillation":
            random = generator(motion.seed, 2)
            shape = FIBRILLATION_CV**-2
            # Refractoriness: the bounds cut one beat in some ten thousand and leave the statistics alone.
            return lambda t: float(np.clip(random.gamma(shape) / shape, 0.4, 2.0)) / motion.heart_rate_hz
        case _:
            return lambda t: 1.0 / motion.heart_rate_hz


def _variable_intervals(motion: RhythmSettings) -> Callable[[float], float]:
    """RR = (1 + CV·w(t)) / (f + drift(t)) + RSA/2·sin(2π θ_r), w of unit variance with ECGSYN's spectrum."""
    random = generator(motion.seed, 2)
    bands = np.repeat([WAVES_HZ, motion.respiratory_rate_hz], WAVES_PER_BAND)
    frequencies = random.normal(bands, WAVES_WIDTH_HZ)
    power = np.repeat([LF_TO_HF, 1.0], WAVES_PER_BAND) / ((1.0 + LF_TO_HF) * WAVES_PER_BAND)
    amplitudes, phases = np.sqrt(2.0 * power), random.uniform(0.0, 2.0 * np.pi, len(bands))
    drift, drift_phase = motion.heart_rate_drift / 60.0, random.uniform(0.0, 2.0 * np.pi)

    def interval(t: float) -> float:
        waves = float(amplitudes @ np.cos(2.0 * np.pi * frequencies * t + phases))
        rate = motion.heart_rate_hz + drift * np.sin(2.0 * np.pi * t / DRIFT_PERIOD + drift_phase)
        breath, pace = respiratory_phase(motion, np.array([t]))
        # Without breathing, no sinus arrhythmia: it fades with the rate of respiration.
        swing = np.sin(2.0 * np.pi * breath[0]) * pace[0] / motion.respiratory_rate_hz
        rr = (1.0 + motion.rr_variation * waves) / rate + 0.5 * motion.sinus_arrhythmia * swing
        # All keys at their bounds together could ask for an interval below 0.
        return max(float(rr), 0.3 / motion.heart_rate_hz)

    return interval


def _with_premature_beats(onsets: np.ndarray, burst: tuple[int, int], random: np.random.Generator) -> Beats:
    """Sinus beats replaced by earlier ones; the sinus goes on undisturbed, hence the full compensatory pause."""
    moved, gain = onsets.copy(), np.ones(len(onsets))
    last = 0
    while last < len(onsets):
        first = last + int(random.integers(*PREMATURE_PERIOD, endpoint=True))
        last = first + 2 * (int(random.integers(*burst, endpoint=True)) - 1)
        # Within a burst they are alike: fixed coupling is the mark of bigeminy.
        coupling, weak, strong = (random.uniform(*bounds) for bounds in (COUPLING, PREMATURE_GAIN, NEXT_GAIN))
        premature = np.arange(first, min(last + 1, len(onsets) - 1), 2)
        moved[premature] = onsets[premature - 1] + coupling * (onsets[premature] - onsets[premature - 1])
        gain[premature], gain[premature + 1] = weak, strong
    return Beats(moved, gain)
