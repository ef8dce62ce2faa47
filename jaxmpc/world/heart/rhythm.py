"""When the heart beats and the lungs breathe: beat onsets, cardiac and respiratory phase in continuous time.

Everything random is drawn beat by beat from the seed, or is a sum of waves drawn once, so a longer run
extends a shorter one and never changes it, and the spacing of the times asked for changes nothing.
"""

from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np

from jaxmpc.world.heart.bounds import Seconds, Seed
from jaxmpc.world.heart.harmonics import fade_in, fade_in_rate

NOMINAL_CYCLE = 1.0 / 1.265
"""Cycle of the harmonic table, the comb through the peaks of the paper's Fig. 4 [s]."""
SYSTOLE = 0.4
"""Part of the table's cycle that its stroke and return take [cycles]."""
LONGEST_SYSTOLE = 0.5
"""Part of a short cycle that systole takes at most (chosen here) [-]."""
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
GAIN_BLEND = 0.3
"""Last part of a cycle, near rest, in which the gain goes over to the next beat's [cycles]."""
HOLD_RAMP = 0.5
"""Time in which the lungs come to rest and start again [s]."""
COUGH, COUGH_DURATION = 0.010, 0.3
"""Displacement of a cough [m] and the time in which it is reached, and undone [s]."""


HeartRate = Annotated[float, msgspec.Meta(ge=0.6, le=2.5)]


class RhythmSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a rhythm is made from.

    Where a figure comes from: (published), (usual practice), or (chosen here).
    """

    seed: Seed = 0
    """Seed of the phases, and of all that a rhythm draws."""
    rhythm: Literal["steady", "variability", "rate-step", "premature", "bigeminy", "fibrillation"] = "steady"
    """"premature": one beat in 10–20 comes early, at 45–75 % of the cycle (published), and a full compensatory pause
    follows; its displacement is × 0.5–0.8, the next one's × 1.1–1.3 (chosen here). "bigeminy": bursts in which every
    other beat is one. "fibrillation": RR varies by 20 %, no beat knowing of the last (chosen here)."""
    heart_rate_hz: HeartRate = 1.265
    """Mean heart rate of every rhythm but the rate step [Hz] (published)."""
    rr_variation: Annotated[float, msgspec.Meta(ge=0.0, le=0.1)] = 0.02
    """Variability: standard deviation over mean of the RR interval, ECGSYN's two bands [-] (published: 2.2 %)."""
    sinus_arrhythmia: Annotated[float, msgspec.Meta(ge=0.0, le=0.1)] = 0.02
    """Variability: peak to peak of RR over one breath [s] (published: 0.011–0.037)."""
    heart_rate_drift: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] = 10.0
    """Variability: slow drift to either side, from end to end in 60 s [1/min] (chosen here)."""
    rate_step_hz: tuple[HeartRate, HeartRate] = (1.0, 110.0 / 60.0)
    """Rate step: heart rate before and after it, 60 and 110 per minute; it takes 3 s [Hz] (chosen here)."""
    rate_step_at: Seconds = 10.0
    """When the rate step begins [s]."""
    ventilation: Literal["steady", "hold", "cough"] = "steady"
    """"hold": the ventilator stops once. "cough": 10 mm in 0.3 s along the direction of breathing, and back."""
    respiratory_rate_hz: Annotated[float, msgspec.Meta(ge=0.2, le=0.45)] = 0.35
    """Ventilator rate [Hz] (published: 0.34 and twice that; usual practice: 12–25 per minute)."""
    ventilation_at: Seconds = 10.0
    """When the hold or the cough begins [s]."""
    hold_duration: Annotated[float, msgspec.Meta(ge=1.0, le=60.0)] = 10.0
    """Length of the hold [s] (usual practice: 10–30)."""
    amplitude_spread: Annotated[float, msgspec.Meta(ge=0.0, le=0.9)] = 0.0
    """Half-width of a factor on the amplitude about 1, drawn once per axis [-] (chosen here: 0.3)."""
    drift: Annotated[float, msgspec.Meta(ge=0.0, le=0.02)] = 0.0
    """Drift of the baseline in a drawn direction, not scaled [m/min] (chosen here: 0.002)."""


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


def respiratory_phase(motion: RhythmSettings, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phase of the ventilator, shape (n,) [cycles], and its rate, shape (n,) [cycles/s].

    During a hold the lungs stay where it found them.
    """
    rate = motion.respiratory_rate_hz
    if motion.ventilation != "hold":
        return rate * t, np.full(np.shape(t), rate)
    held, holding = (
        before - after
        for before, after in zip(
            *(_ramp(t, at) for at in (motion.ventilation_at, motion.ventilation_at + motion.hold_duration)), strict=True
        )
    )
    return rate * (t - held), rate * (1.0 - holding)


def _ramp(t: np.ndarray, start: float) -> tuple[np.ndarray, np.ndarray]:
    """The integral of `fade_in` over `HOLD_RAMP`, and `fade_in` itself."""
    s = np.clip((t - start) / HOLD_RAMP, 0.0, 1.0)
    integral = HOLD_RAMP * s**4 * (2.5 - 3.0 * s + s**2) + np.maximum(t - start - HOLD_RAMP, 0.0)
    return integral, fade_in(t, start, HOLD_RAMP)


def cough(motion: RhythmSettings, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the cough along the direction of breathing, shape (n,) [m], and its velocity [m/s]."""
    if motion.ventilation != "cough":
        return np.zeros(np.shape(t)), np.zeros(np.shape(t))
    begin, end = motion.ventilation_at, motion.ventilation_at + COUGH_DURATION
    shape = fade_in(t, begin, COUGH_DURATION) - fade_in(t, end, COUGH_DURATION)
    rate = fade_in_rate(t, begin, COUGH_DURATION) - fade_in_rate(t, end, COUGH_DURATION)
    return COUGH * shape, COUGH * rate
