"""Motion of the heart: smooth, reproducible, with the published statistics; recordings are read with suspicion."""

import math
from itertools import pairwise
from typing import Any, get_args, get_type_hints

import msgspec
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmpc import InputError
from jaxmpc.world.heart import harmonics, rhythm
from jaxmpc.world.heart.motion import Motion, displacement
from jaxmpc.world.heart.phase import cardiac_phase

T = np.arange(0.0, 40.0, 1e-3)
HOUR = 3600.0
RHYTHMS: tuple[Any, ...] = get_args(get_type_hints(Motion)["rhythm"])
VENTILATIONS: tuple[Any, ...] = get_args(get_type_hints(Motion)["ventilation"])

motions = st.builds(
    Motion,
    kind=st.just("rhythm"),
    rhythm=st.sampled_from(RHYTHMS),
    ventilation=st.sampled_from(VENTILATIONS),
    phases=st.sampled_from(["table", "random"]),
    seed=st.integers(0, 2**63 - 1),
    heart_rate_hz=st.floats(0.8, 2.0),
    respiratory_rate_hz=st.floats(0.2, 0.45),
    start=st.floats(0.0, 5.0),
    fade=st.floats(0.3, 2.0),
    amplitude_spread=st.floats(0.0, 0.5),
    drift=st.floats(0.0, 0.01),
)


def rhythmic(name: Any = "steady", **keys: Any) -> Motion:
    return Motion(kind="rhythm", rhythm=name, **keys)


def rr(motion: Motion, seconds: float = HOUR) -> tuple[np.ndarray, np.ndarray]:
    """Onsets and RR intervals."""
    onsets = rhythm.beats(motion, seconds).onsets
    return onsets[:-1], np.diff(onsets)


def test_harmonics_have_the_seven_peaks_of_the_paper() -> None:
    motion = displacement(Motion(fade=0.0), T)[0]
    spectrum = np.abs(np.fft.rfft(motion[:, 2] * np.hanning(len(T))))
    peaks = scipy.signal.find_peaks(spectrum, height=0.02 * spectrum.max())[0]
    hertz = np.fft.rfftfreq(len(T), 1e-3)[peaks]
    np.testing.assert_allclose(hertz, [0.34, 0.72, 1.25, 2.53, 3.78, 5.08, 6.32], atol=0.05)


def test_harmonics_have_the_size_of_the_table() -> None:
    """RMS and peak to peak per axis as tabulated with the amplitudes."""
    motion = harmonics.harmonic_motion(np.arange(0.0, 600.0, 5e-3))
    np.testing.assert_allclose(1e3 * motion.std(axis=0), [1.40, 1.17, 2.75], rtol=0.02)
    np.testing.assert_allclose(1e3 * np.ptp(motion, axis=0), [7.4, 6.1, 14.3], rtol=0.05)


@pytest.mark.parametrize("kind", ["harmonics", "rhythm"])
def test_phases_come_from_the_seed_alone(kind: Any) -> None:
    motion = Motion(kind=kind, phases="random")
    one, same, other = (displacement(msgspec.structs.replace(motion, seed=seed), T)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.allclose(one, other)
    assert one.std() == pytest.approx(other.std(), rel=0.05)


def test_steady_rhythm_is_the_table_locked_to_two_frequencies() -> None:
    """200 s hold whole cycles of all: each line stands in one bin, and there is nothing between."""
    motion = displacement(rhythmic(fade=0.0), np.arange(0.0, 200.0, 0.02))[0]
    spectrum = 2.0 * np.abs(np.fft.rfft(motion, axis=0)) / len(motion)
    lines = [70, 140, *(253 * order for order in range(1, 6))]
    np.testing.assert_allclose(lines, 200.0 * np.array([0.35, 0.70, 1.265, 2.53, 3.795, 5.06, 6.325]))
    np.testing.assert_allclose(1e3 * spectrum[lines].T, harmonics.AMPLITUDES_MM, rtol=1e-9)
    assert np.delete(spectrum, lines, axis=0).max() < 1e-12


@settings(max_examples=20, deadline=None)
@given(motion=motions, times=st.lists(st.floats(0.1, 30.0), min_size=50, max_size=50))
def test_velocity_is_the_derivative(motion: Motion, times: list[float]) -> None:
    assert_velocity(motion, np.sort(times))


@pytest.mark.parametrize("phases", ["table", "random"])
def test_velocity_of_the_harmonics_is_the_derivative(phases: Any) -> None:
    assert_velocity(Motion(phases=phases, scale=1.5, start=2.0, fade=3.0), np.linspace(0.1, 20.0, 500))


def assert_velocity(motion: Motion, t: np.ndarray) -> None:
    step = 2e-5
    velocity = displacement(motion, t)[1]
    difference = (displacement(motion, t + step)[0] - displacement(motion, t - step)[0]) / (2.0 * step)
    largest = np.abs(displacement(motion, np.arange(0.0, t[-1], 0.01))[1]).max()
    np.testing.assert_allclose(velocity, difference, rtol=0.0, atol=1e-6 * max(largest, 1e-3))


def jump_of_acceleration(motion: Motion, step: float) -> float:
    velocity = displacement(motion, np.arange(8.0, 15.0, step))[1]
    return float(np.abs(np.diff(velocity, 2, axis=0)).max()) / step


@pytest.mark.parametrize(
    ("name", "ventilation"), [*((name, "steady") for name in RHYTHMS), *(("steady", way) for way in VENTILATIONS[1:])]
)
def test_acceleration_is_continuous(name: str, ventilation: Any) -> None:
    """A jump would stay as the grid gets finer; what is continuous changes less in less time."""
    motion = rhythmic(name, ventilation=ventilation, start=9.0, drift=0.002)
    assert jump_of_acceleration(motion, 1e-4) < 0.2 * jump_of_acceleration(motion, 1e-3)


def test_a_jump_of_acceleration_would_be_seen() -> None:
    motion = rhythmic(start=9.0, fade=0.0)
    assert jump_of_acceleration(motion, 1e-4) > 0.5 * jump_of_acceleration(motion, 1e-3)


@settings(max_examples=20, deadline=None)
@given(motion=motions, short=st.floats(0.1, 40.0))
def test_longer_or_finer_times_change_nothing(motion: Motion, short: float) -> None:
    t = np.arange(0.0, 60.0, 0.005)
    whole = displacement(motion, t)
    coarse = t[t <= short][::2]
    for signal, part in zip(whole, displacement(motion, coarse), strict=True):
        np.testing.assert_array_equal(signal[: 2 * len(coarse) : 2], part)


@pytest.mark.parametrize("name", ["variability", "premature", "bigeminy", "fibrillation"])
def test_beats_come_from_the_seed_alone(name: str) -> None:
    one, same, other = (rhythm.beats(rhythmic(name, seed=seed), 100.0).onsets[:100] for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.allclose(one, other)


@settings(deadline=None)
@given(intervals=st.lists(st.floats(0.15, 4.0), min_size=4, max_size=12))
def test_phase_increases_through_any_onsets(intervals: list[float]) -> None:
    onsets = np.concatenate([[0.0], np.cumsum(intervals)])
    t = np.linspace(0.0, onsets[-3], 4000)
    phase, rate = cardiac_phase(onsets, t)
    assert (rate > 0.0).all()
    assert (np.diff(phase) > 0.0).all()
    begun, rate = cardiac_phase(onsets, onsets[:-2])
    np.testing.assert_allclose(begun, np.arange(len(onsets) - 2), atol=1e-12)
    # What makes it increase: no slope at an onset far above the mean one of the systole that follows.
    systole = np.interp(begun[:-1] + 0.4, phase, t) - onsets[:-3]
    assert (rate[:-1] < 1.25 * 0.4 / systole).all()


@pytest.mark.parametrize(("cycle", "systole"), [(0.79, 0.316), (1.6, 0.45), (0.5, 0.25), (0.3, 0.15)])
def test_systole_changes_less_than_the_cycle(cycle: float, systole: float) -> None:
    """0.4 of the table's cycle there; √RR beyond it, half of the cycle in short ones."""
    t = np.linspace(0.0, cycle, 10001)
    phase = cardiac_phase(cycle * np.arange(6), t)[0]
    assert np.interp(0.4, phase, t) == pytest.approx(systole, abs=2e-3)


def test_variability_has_the_mean_and_the_spread_of_its_keys() -> None:
    for variation in (0.01, 0.03):
        _, interval = rr(rhythmic("variability", rr_variation=variation, sinus_arrhythmia=0.0, heart_rate_drift=0.0))
        assert interval.mean() == pytest.approx(0.79, abs=0.005)
        assert interval.std() / interval.mean() == pytest.approx(variation, rel=0.1)


def test_variability_has_two_bands() -> None:
    """Fourier transform at the uneven onsets: interpolating between them would damp the upper band."""
    onsets, interval = rr(rhythmic("variability", sinus_arrhythmia=0.0, heart_rate_drift=0.0), 1800.0)
    hertz = np.arange(0.005, 0.6, 0.0005)
    power = np.abs(np.exp(-2j * np.pi * np.outer(hertz, onsets)) @ (interval - interval.mean())) ** 2
    low, high = (power[abs(hertz - centre) < 0.04].sum() for centre in (0.1, 0.35))
    assert (low + high) / power.sum() > 0.98
    assert low / high == pytest.approx(0.5, abs=0.1)


def test_sinus_arrhythmia_is_locked_to_respiration() -> None:
    motion = rhythmic("variability", rr_variation=0.0, heart_rate_drift=0.0, sinus_arrhythmia=0.03)
    onsets, interval = rr(motion, 600.0)
    breath = np.sin(2.0 * np.pi * 0.35 * onsets)
    np.testing.assert_allclose(interval - 1.0 / 1.265, 0.015 * breath, atol=1e-9)
    held = msgspec.structs.replace(motion, ventilation="hold")
    onsets, interval = rr(held, 30.0)
    assert np.ptp(interval[(onsets > 10.5) & (onsets < 20.0)]) < 1e-12


def test_heart_rate_drifts_from_end_to_end_in_a_minute() -> None:
    onsets, interval = rr(rhythmic("variability", rr_variation=0.0, sinus_arrhythmia=0.0), 240.0)
    rate = 60.0 / interval
    assert [rate.min(), rate.max()] == pytest.approx([65.9, 85.9], abs=0.05)
    apart = abs(onsets[np.argmax(rate)] - onsets[np.argmin(rate)]) % 120.0
    assert apart == pytest.approx(60.0, abs=4.0)


def test_rate_steps_from_60_to_110_in_3_s() -> None:
    onsets, interval = rr(rhythmic("rate-step", rate_step_at=8.0), 30.0)
    rate = 60.0 / interval
    np.testing.assert_allclose(rate[onsets <= 8.0], 60.0)
    np.testing.assert_allclose(rate[onsets >= 11.0], 110.0)
    assert ((rate[(onsets > 8.1) & (onsets < 10.9)] > 60.0) & (rate[(onsets > 8.1) & (onsets < 10.9)] < 110.0)).all()


def test_premature_beat_is_followed_by_a_full_compensatory_pause() -> None:
    onsets, gain = rhythm.beats(rhythmic("premature"), HOUR)
    early = np.flatnonzero(gain < 1.0)
    assert set(np.diff(early)) == set(range(10, 21))
    before, after = onsets[early] - onsets[early - 1], onsets[early + 1] - onsets[early]
    np.testing.assert_allclose(before + after, 2.0 / 1.265)
    coupling = before * 1.265
    assert [coupling.min(), coupling.max()] == pytest.approx([0.45, 0.75], abs=0.01)
    assert coupling.mean() == pytest.approx(0.60, abs=0.02)
    assert [gain[early].min(), gain[early].max()] == pytest.approx([0.5, 0.8], abs=0.01)
    assert [gain[early + 1].min(), gain[early + 1].max()] == pytest.approx([1.1, 1.3], abs=0.01)
    sinus = np.delete(np.diff(onsets), [*early, *(early - 1)])
    np.testing.assert_allclose(sinus, 1.0 / 1.265)


def test_bigeminy_comes_in_bursts_of_fixed_coupling() -> None:
    onsets, gain = rhythm.beats(rhythmic("bigeminy"), HOUR)
    early = np.flatnonzero(gain < 1.0)
    bursts = np.split(early, np.flatnonzero(np.diff(early) > 2) + 1)[:-1]
    assert {len(burst) for burst in bursts} == set(range(4, 9))
    for burst in bursts:
        assert np.ptp(onsets[burst] - onsets[burst - 1]) < 1e-9
        assert set(np.diff(burst)) == {2}


def test_fibrillation_has_no_memory() -> None:
    _, interval = rr(rhythmic("fibrillation"))
    assert interval.mean() == pytest.approx(1.0 / 1.265, rel=0.015)
    assert interval.std() / interval.mean() == pytest.approx(0.20, abs=0.01)
    assert abs(np.corrcoef(interval[1:], interval[:-1])[0, 1]) < 0.05


def test_stroke_of_a_premature_beat_is_weak_and_the_next_one_strong() -> None:
    motion = rhythmic("premature", fade=0.0)
    onsets, gain = rhythm.beats(motion, 100.0)
    t = np.arange(0.0, 100.0, 1e-3)
    breathing = 1e-3 * sum(
        harmonics.AMPLITUDES_MM[2, k]
        * np.cos(2.0 * np.pi * 0.35 * (k + 1) * t + np.deg2rad(harmonics.PHASES_DEG[2, k]))
        for k in (0, 1)
    )
    beating = displacement(motion, t)[0][:, 2] - breathing
    peaks = np.array([beating[(t >= a) & (t < b)].max() for a, b in pairwise(onsets) if b < 100.0])
    np.testing.assert_allclose(peaks / peaks[0], gain[: len(peaks)], rtol=0.01)
    assert len(set(gain[: len(peaks)])) > 5


def test_hold_stops_respiration_and_lets_it_go_on() -> None:
    t = np.arange(0.0, 40.0, 0.01)
    moved = displacement(rhythmic(ventilation="hold", fade=0.0), t)[0]
    free = displacement(rhythmic(fade=0.0), t)[0]
    beating = free - harmonics.respiration(0.35 * t)[0]
    breathing = moved - beating
    held = (t >= 10.5) & (t <= 20.0)
    assert np.ptp(breathing[held], axis=0).max() < 1e-12
    np.testing.assert_array_equal(moved[t <= 10.0], free[t <= 10.0])
    late = t >= 20.5
    np.testing.assert_allclose(breathing[late], harmonics.respiration(0.35 * (t[late] - 10.0))[0], atol=1e-12)


def test_cough_moves_10_mm_in_300_ms_and_back() -> None:
    t = np.arange(0.0, 12.0, 0.01)
    cough = displacement(rhythmic(ventilation="cough"), t)[0] - displacement(rhythmic(), t)[0]
    size = np.linalg.norm(cough, axis=1)
    assert t[np.argmax(size)] == pytest.approx(10.3)
    assert size.max() == pytest.approx(0.010)
    assert not size[(t <= 10.0) | (t >= 10.601)].any()


def test_baseline_drifts_at_its_rate() -> None:
    t = np.array([0.0, 60.0, 120.0])
    drifted = displacement(rhythmic(drift=0.002, scale=0.5), t)[0] - displacement(rhythmic(scale=0.5), t)[0]
    np.testing.assert_allclose(np.linalg.norm(drifted, axis=1), [0.0, 0.002, 0.004])


@pytest.mark.parametrize(
    "motion",
    [
        *(rhythmic(name) for name in ("steady", "rate-step", "variability", "premature", "bigeminy", "fibrillation")),
        rhythmic("variability", rr_variation=0.0, heart_rate_drift=0.0),
        rhythmic(ventilation="cough"),
        rhythmic(amplitude_spread=0.1),
        rhythmic(drift=1e-3),
        rhythmic(phases="random"),
        Motion(),
        Motion(phases="random"),
        Motion(kind="none"),
    ],
    ids=str,
)
def test_a_motion_that_says_it_is_drawn_is_another_one_from_another_seed(motion: Motion) -> None:
    t = np.arange(0.0, 40.0, 0.02)
    one, other = (displacement(msgspec.structs.replace(motion, seed=seed), t)[0] for seed in (0, 1))
    assert motion.drawn == (not np.array_equal(one, other))


def test_amplitudes_are_drawn_once_per_axis_within_their_spread() -> None:
    t = np.arange(5.0, 20.0, 0.1)
    free = displacement(rhythmic(), t)[0]
    factors = []
    for seed in range(100):
        drawn = displacement(rhythmic(amplitude_spread=0.3, seed=seed), t)[0]
        factors.append((drawn * free).sum(axis=0) / (free**2).sum(axis=0))
        np.testing.assert_allclose(drawn, factors[-1] * free, atol=1e-12)
    assert [np.min(factors), np.max(factors)] == pytest.approx([0.7, 1.3], abs=0.02)
    assert np.mean(factors) == pytest.approx(1.0, abs=0.04)


FLOATS = [field.name for field in msgspec.structs.fields(Motion) if isinstance(field.default, float)]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1.0, 1e5])
@pytest.mark.parametrize("key", [*FLOATS, "rate_step_hz"])
def test_value_out_of_bounds_is_refused(key: str, bad: float) -> None:
    value = (1.0, bad) if key == "rate_step_hz" else bad
    with pytest.raises(InputError, match=rf"motion\.{key}"):
        displacement(msgspec.structs.replace(rhythmic(), **{key: value}), T[:10])


def test_key_of_a_rhythm_is_refused_elsewhere() -> None:
    with pytest.raises(InputError, match=r'motion\.ventilation = cough.*kind = "rhythm"'):
        Motion(ventilation="cough")


@pytest.mark.parametrize("t", [[0.0, -1.0], [1.0, 0.5], [0.0, math.nan], [[0.0]]])
def test_times_that_go_back_are_refused(t: list[Any]) -> None:
    with pytest.raises(InputError, match="do not decrease"):
        displacement(Motion(), np.array(t))


@pytest.mark.parametrize("kind", ["none", "harmonics", "rhythm"])
def test_no_times_give_no_motion(kind: Any) -> None:
    assert [signal.shape for signal in displacement(Motion(kind=kind), np.zeros(0))] == [(0, 3), (0, 3)]
