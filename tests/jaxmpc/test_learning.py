"""What is learned of the beat: on hearts of every rhythm, against its linear model, and that against its response."""

from dataclasses import replace
from typing import Any

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from msgspec.structs import replace as changed

from jaxmpc import Experiment, InputError, Params, design, evaluate
from jaxmpc.engine.base import scalars
from jaxmpc.law import pulse, repetition
from jaxmpc.law.ops import FLOATS
from jaxmpc.stability import held_beat
from jaxmpc.stability.family import held
from jaxmpc.stability.held_beat import HeldBeat
from jaxmpc.stability.loop import closed_loop_matrix, contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.synthesis.learning import PULLING
from jaxmpc.synthesis.learning import repetition as constants_of
from jaxmpc.world.arrays import ARRAYS
from jaxmpc.world.heart.motion import Motion, prepared

pytestmark = pytest.mark.once

T_s = 1e-3
FAMILY = Params.published("family")
LEARNING: Any = jax.tree.map(float, constants_of(8, 2.5, T_s))
FREQUENCIES = 2.0 * np.pi * np.array([0.3, 1.0, 1.3, 2.7, 7.7, 9.9, 11.0, 17.0, 30.0, 200.0])


def found_pulse(motions: list[Motion], seconds: float) -> pulse.Pulse:
    """What is known at every sample of tips that follow these hearts exactly, each field (samples, hearts)."""
    t = T_s * np.arange(round(seconds / T_s))
    speeds = np.stack([prepared(motion, seconds)(t)[1][:, 2] for motion in motions], axis=1)
    state, rows = pulse.init(LEARNING.finder, speeds[0]), []
    for speed in speeds:
        state, _ = pulse.step(LEARNING.finder, state, speed, ARRAYS)
        rows.append(state)
    return jax.tree.map(lambda *each: np.stack(each), *rows)


def hearts(rhythm: str, rates: list[float]) -> list[Motion]:
    """Breathing, with drawn phases and amplitudes."""
    return [
        Motion(kind="rhythm", rhythm=rhythm, phases="random", seed=i, heart_rate_hz=f, start=1.0, amplitude_spread=0.3)
        for i, f in enumerate(rates)
    ]


def test_the_rate_of_any_heart_is_found_in_ten_seconds() -> None:
    """Within what the second harmonic of breathing, at 0.7 Hz, makes of it."""
    rates = [0.9, 1.0, 1.265, 1.5, 1.83, 2.2, 2.45]
    known = found_pulse(hearts("steady", rates), 16.0)
    relative = known.rate[12_000:] / (2.0 * np.pi * np.array(rates)) - 1.0
    assert np.max(np.abs(relative)) < 0.1
    assert np.max(np.abs(np.mean(relative, axis=0))) < 0.02


def test_a_rate_that_steps_is_followed_and_the_phase_never_jumps() -> None:
    steps, irregular = hearts("rate-step", [1.2]), hearts("fibrillation", [1.265, 1.5])
    known = found_pulse(steps + irregular, 18.0)
    assert known.rate[9000, 0] == pytest.approx(2.0 * np.pi * 1.0, rel=0.05)
    np.testing.assert_allclose(known.rate[16_000:, 0], 2.0 * np.pi * 110.0 / 60.0, rtol=0.05)
    cosine, sine = known.phase
    np.testing.assert_allclose(np.hypot(cosine, sine), 1.0, rtol=1e-6)  # a rotation's, to the fourth power of 0.02
    turned = np.angle((cosine[1:] + 1j * sine[1:]) * (cosine[:-1] - 1j * sine[:-1])) / T_s
    assert np.max(np.abs(turned - known.rate[:-1])) <= PULLING + 1e-3


def swept_tip(seconds: float) -> np.ndarray:
    """Speeds of a tip that is slower than any heart, then faster than any, then hardly moves, then does again [m/s]."""
    at = np.arange(round(seconds / T_s)) * T_s / seconds
    frequency = np.interp(at, [0.0, 0.25, 0.6, 0.7, 0.71, 1.0], [0.45, 0.45, 3.3, 3.3, 1.4, 1.4])
    size = np.select([at < 0.7, at < 0.85], [3e-3, 3e-5], 3e-3)
    speed: np.ndarray = np.gradient(size * np.sin(2.0 * np.pi * T_s * np.cumsum(frequency)), T_s)
    return speed


def test_what_is_known_of_the_heart_is_what_the_equations_say() -> None:
    """In complex numbers, with scipy's filters and exact rotations; 2.5e-9 m² count as half a heart."""
    finder, speeds, half = LEARNING.finder, swept_tip(20.0), 2.5e-9
    kept = 1.0 - finder.slow
    once = scipy.signal.lfilter([1.0, -1.0], [1.0, -kept], T_s * np.cumsum(speeds))
    displacement = scipy.signal.lfilter([kept, -kept], [1.0, -kept], once)
    rate, phase, x, expected, held = finder.first, 0.0, 0j, [], 0
    for y in displacement:
        share = rate * T_s / (2.0 * np.pi * finder.cycles)
        x = (1.0 - share) * np.exp(1j * rate * T_s) * x + share * y
        size = abs(x) ** 2 + half
        stray = (x.conjugate() * y).imag * share / (T_s * size)
        held += abs(stray) > 3.0
        phase += rate * T_s + finder.pulling * T_s * np.sin(np.angle(x) - phase) * abs(x) / np.sqrt(size)
        rate = np.clip(rate + finder.following * share * np.clip(stray, -3.0, 3.0), finder.least, finder.most)
        expected.append((rate, np.cos(phase), np.sin(phase), x.real, x.imag, abs(x) ** 2 / size))
    state, found = pulse.init(finder, 0.0), []
    for speed in speeds.tolist():
        state, heard = pulse.step(finder, state, speed, FLOATS)
        found.append((state.rate, *state.phase, *state.turning, heard))
    rates, sureness = np.array(expected)[:, 0], np.array(expected)[:, 5]
    assert (rates.min(), rates.max()) == (finder.least, finder.most), "it meets both bounds"
    assert held > 100
    assert sureness.min() < 0.3
    # The law turns by its angle plus a sixth of its cube, up to 0.7 mrad/s too fast; in the seconds in which φ is half
    # a turn away from arg x, where the sine drives it off, that grows to 30 mrad.
    apart = np.max(np.abs(np.array(found) - np.array(expected)), axis=0)
    assert np.all(apart < [2e-3, 0.06, 0.06, 1e-6, 1e-6, 1e-3]), apart


def test_a_tip_that_rests_is_no_heart() -> None:
    state, noise = pulse.init(LEARNING.finder, 0.0), np.random.Generator(np.random.Philox(3))
    for speed in 1e-4 * noise.standard_normal(5000):
        state, heard = pulse.step(LEARNING.finder, state, float(speed), FLOATS)
    assert heard < 0.05


def steady_beat(rate: float, sample: int) -> repetition.Beat:
    angle = rate * T_s * sample
    known = pulse.Pulse(rate, (np.cos(angle), np.sin(angle)), (0.0, 0.0), (0.0, 0.0))
    return repetition.beat_of(LEARNING, known, FLOATS)


def test_all_of_an_error_that_repeats_is_taken_away_and_earns_its_use() -> None:
    """An error of six harmonics with noise, to which the loop answers after 3 ms."""
    rate, random = 2.0 * np.pi * 1.265, np.random.Generator(np.random.Philox(4))
    learned, added, left, used = repetition.nothing(LEARNING, 0.0), [0.0] * 3, [], []
    for k in range(30_000):
        repeats = sum(0.03 * np.cos(n * rate * T_s * k + n * n) / n for n in range(1, 7))
        error = repeats + 0.005 * random.standard_normal() + added[-3]
        learned, more = repetition.step(LEARNING, learned, steady_beat(rate, k), error, 1.0, FLOATS)
        added.append(more)
        left.append(repeats + added[-4])
        used.append(learned.used)
    assert np.std(left[:1000]) > 0.02
    assert np.std(left[-5000:]) < 0.002
    assert min(used[-5000:]) > 0.99


def test_of_an_error_that_does_not_repeat_hardly_anything_is_used() -> None:
    rate, random = 2.0 * np.pi * 1.265, np.random.Generator(np.random.Philox(5))
    learned, added, drawn, slow = repetition.nothing(LEARNING, 0.0), 0.0, [], 0.0
    sums = []
    for k in range(30_000):
        slow += 2.0 * np.pi * 5.0 * T_s * (0.2 * random.standard_normal() - slow)
        learned, added = repetition.step(LEARNING, learned, steady_beat(rate, k), slow + added, 1.0, FLOATS)
        drawn.append(slow)
        sums.append(slow + added)
    assert np.std(sums[5000:]) < 1.05 * np.std(drawn[5000:])


def test_what_is_learned_is_what_the_equations_say() -> None:
    """In complex numbers: rates at which harmonics fade, authority that comes and goes, errors of any size."""
    constants = LEARNING._replace(gains=tuple(3.0 * gain for gain in LEARNING.gains))  # soon above the largest force
    t = T_s * np.arange(16_000)
    rates = 2.0 * np.pi * np.interp(t, [0.0, 8.0, 12.0, 16.0], [1.265, 1.265, 2.0, 1.5])
    phases, random = T_s * np.cumsum(rates), np.random.Generator(np.random.Philox(7))
    authorities = np.interp(t, [0.0, 1.0, 12.0, 13.0, 14.0, 15.0], [0.0, 1.0, 1.0, 0.3, 0.3, 1.0])
    errors = 0.25 * np.cos(phases) + 0.05 * np.cos(6.0 * phases + 1.0) + 0.02 * random.standard_normal(len(t))
    errors += 0.5 * np.exp(-(((t % 3.0 - 1.5) / 0.03) ** 2)) + np.where(t > 14.0, 0.1, 0.0)
    low_pass = [LEARNING.smoothing], [1.0, LEARNING.smoothing - 1.0]
    slow = scipy.signal.lfilter(*low_pass, scipy.signal.lfilter(*low_pass, errors))

    n, gains = np.arange(1, 9), np.asarray(constants.gains)
    c, h, of_whole, of_without, expected = np.zeros(8, complex), 0.0, 0.0, 0.0, []
    for e, error, rate, phase, authority in zip(slow, errors, rates, phases, authorities, strict=True):
        u, shares = np.exp(1j * n * phase), np.clip((LEARNING.highest - n * rate) / 12.0, 0.0, 1.0)
        rho = np.sum(shares * c * u).real
        e_0 = e - h * rho
        e_1 = e_0 + rho
        of_whole += LEARNING.judging * rate * (e_1**2 - of_whole)
        of_without += LEARNING.judging * rate * (e_0**2 - of_without)
        c = c - authority * gains * shares * rate * np.clip(e_1, -0.1, 0.1) * u.conj()
        h = authority * np.clip(2.0 * (1.0 - of_whole / (of_without + 1e-12)), 0.0, 1.0)
        h *= np.clip(2.0 - abs(error) / 0.3, 0.0, 1.0)
        r = np.sum(shares * c * u * np.exp(1j * n * rate * LEARNING.lead)).real
        expected.append((h * np.clip(r, -1.0, 1.0), h, r, e_1))

    learned, found = repetition.nothing(constants, 0.0), []
    for error, rate, phase, authority in zip(
        *map(np.ndarray.tolist, (errors, rates, phases, authorities)), strict=True
    ):
        known = pulse.Pulse(rate, (np.cos(phase), np.sin(phase)), (0.0, 0.0), (0.0, 0.0))
        beat = repetition.beat_of(constants, known, FLOATS)
        learned, added = repetition.step(constants, learned, beat, error, authority, FLOATS)
        found.append((added, learned.used))
    _, used, wanted, whole = np.abs(expected).T
    assert wanted.max() > 1.1, "the largest force acts"
    assert used.max() == 1.0
    assert (whole > 0.1).any(), "an error too large to learn from acts"
    assert np.count_nonzero((used > 0.0) & (used < 0.9)) > 1000
    np.testing.assert_allclose(found, np.array(expected)[:, :2], rtol=0, atol=1e-9)  # sums in another order


def resonators(rate: float, gains: Any = LEARNING) -> tuple[HeldBeat, Any]:
    beat = HeldBeat(gains, jnp.asarray(rate))
    return beat, held_beat.still(beat)


def test_at_a_rate_that_stays_the_law_is_its_linear_model() -> None:
    """With all that is learned in use; small errors, so that none is too large."""
    rate, random = 2.0 * np.pi * 1.7, np.random.Generator(np.random.Philox(6))
    model, state = resonators(rate)
    learned = repetition.nothing(LEARNING, 0.0)
    step, compared = jax.jit(held_beat.step), 0
    for k in range(2000):
        error = 1e-3 * random.standard_normal()
        whole = learned._replace(used=1.0)
        learned, added = repetition.step(LEARNING, whole, steady_beat(rate, k), error, 1.0, FLOATS)
        state, expected = step(model, state, error)
        if learned.used > 0.0:
            compared += 1
            assert added / learned.used == pytest.approx(float(expected), abs=1e-15)  # of 1e-5
    assert compared > 100
    assert np.abs(float(expected)) > 1e-6


def test_what_was_learned_is_not_used_against_an_error_of_another_size() -> None:
    """Full use up to 0.3 N, none from 0.6 N on."""
    rate, learned = 2.0 * np.pi * 1.265, repetition.nothing(LEARNING, 0.0)
    for k in range(5000):
        beat = steady_beat(rate, k)
        seen = sum(part[0] * u[0] - part[1] * u[1] for part, u in zip(learned.parts, beat.now, strict=True))
        error = 0.03 * np.cos(rate * T_s * k) + learned.used * seen
        learned, _ = repetition.step(LEARNING, learned, beat, error, 1.0, FLOATS)
    assert learned.used == 1.0
    for error, used in ((0.3, 1.0), (0.45, 0.5), (-0.6, 0.0), (2.0, 0.0)):
        now, added = repetition.step(LEARNING, learned, steady_beat(rate, 5000), error, 1.0, FLOATS)
        assert now.used == pytest.approx(used, abs=1e-6)
        assert abs(added) <= 0.05 * used


@pytest.mark.oracle
@pytest.mark.parametrize("hertz", [0.6, 1.265, 2.6])
def test_the_response_of_the_model_is_that_of_python_control(hertz: float) -> None:
    model, state = resonators(2.0 * np.pi * hertz)
    flat, back = jax.flatten_util.ravel_pytree(state)

    def one(vector: Any, error: Any) -> Any:
        following, added = held_beat.step(model, back(vector), error)
        return jax.flatten_util.ravel_pytree(following)[0], added

    (A, C), (B, D) = (jax.jacfwd(one, argnums=i)(flat, jnp.zeros(())) for i in (0, 1))
    system = control.ss(np.asarray(A), np.asarray(B)[:, None], np.asarray(C)[None], [[float(D)]], T_s)
    expected = np.squeeze(control.frequency_response(system, FREQUENCIES).complex)
    found = held_beat.response(model, jnp.exp(-1j * T_s * FREQUENCIES))
    np.testing.assert_allclose(-np.asarray(found), expected, rtol=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("late", [1, 2])
@pytest.mark.parametrize("order", [1, 2])
def test_the_loop_that_learns_has_its_poles_where_its_response_says(late: int, order: int) -> None:
    """det(z − A) of the loop with the law in it over that of the loop without is (1 + L')/(1 + L), at any z.

    The learner's own poles are divided out: those of its low-passes, and e^{±jnωT_s}.
    """
    params = Params(Khat_s=900.0, K2=10.0, designed_delay=late, disturbance_order=order, Q_p=1e-3 if order > 1 else 1.0)
    gains = scalars(design(params), preview=False)
    gains = gains._replace(mpc_ref=jnp.stack(list(gains.mpc_ref)))
    contact = contact_of(810.0, params.K2, Experiment.published("table-1").loop_path())
    beat, _ = resonators(2.0 * np.pi * 1.5)
    with_it, without = (np.asarray(closed_loop_matrix(gains, contact, each)) for each in (beat, None))
    theta = T_s * FREQUENCIES
    z = np.exp(1j * theta)

    def characteristic(A: np.ndarray) -> np.ndarray:
        return np.array([np.linalg.det(at * np.eye(len(A)) - A) for at in z])

    frequency = 1.5 * 2.0 * np.pi * np.arange(1, 9)
    learns = frequency < LEARNING.highest
    own = np.prod(
        [
            z**2 - 2.0 * z * np.cos(each * T_s) + 1.0 if known else z**2
            for each, known in zip(frequency, learns, strict=True)
        ],
        axis=0,
    )
    own = own * (z - 1.0 + LEARNING.smoothing) ** 2
    ratio = (1.0 + loop_response(gains, contact, theta, 0.0, held=beat)) / (
        1.0 + loop_response(gains, contact, theta, 0.0)
    )
    np.testing.assert_allclose(characteristic(with_it) / characteristic(without) / own, ratio, rtol=1e-6)


def seen_at_once(constants: Any, rate: float, q: np.ndarray) -> np.ndarray:
    """R₀ at q = z⁻¹ [-]: what is learned of an error, without lead and low-pass, a sample late."""
    turn = rate * T_s * np.arange(1, len(constants.gains) + 1)[:, None]
    shares = np.clip((constants.highest - turn / T_s) / repetition.FADING, 0.0, 1.0)
    learned = np.asarray(constants.gains)[:, None] * rate * shares**2
    response: np.ndarray = np.sum(learned * (q * np.cos(turn) - q**2) / (1.0 - 2.0 * q * np.cos(turn) + q**2), axis=0)
    return response


@pytest.mark.parametrize("used", [0.25, 0.75, 1.0])
def test_with_a_share_in_use_the_law_learns_as_its_linear_model(used: float) -> None:
    """r = −h R/(1 + (1 − h) R₀) e, from the law's answer to an impulse, off the circle, where it fades in seconds."""
    rate, size, seconds = 2.0 * np.pi * 1.3, 1e-3, 4.0
    learned, added = repetition.nothing(LEARNING, 0.0), []
    for k in range(round(seconds / T_s)):
        beat, error = steady_beat(rate, k), size if k == 0 else 0.0
        learned, more = repetition.step(LEARNING, learned._replace(used=used), beat, error, 1.0, FLOATS)
        added.append(used * more / learned.used if learned.used else 0.0)
    q = np.exp(-(8.0 + 1j * FREQUENCIES) * T_s)
    answered = np.array([np.sum(np.array(added) / size * each ** np.arange(len(added))) for each in q])
    R = np.asarray(held_beat.response(HeldBeat(LEARNING, jnp.asarray(rate)), q))
    np.testing.assert_allclose(answered, -used * R / (1.0 + (1.0 - used) * seen_at_once(LEARNING, rate, q)), rtol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("hertz", [0.7, 1.3, 2.3])
def test_what_is_used_in_part_takes_no_margin_either(hertz: float) -> None:
    """With a share h in use, c_n learns of e + (1 − h) times what it would add now: r = −h R/(1 + (1 − h) R₀) e.

    R₀ has no lead, no low-pass and the sample's delay of what is seen. The loop's response is linear in R.
    """
    path = Experiment.published("family-wam").loop_path().with_cutoff(FAMILY.velocity_cutoff)
    whole, rate = design(FAMILY).schedule.repetition, 2.0 * np.pi * hertz
    theta = (np.arange(1.0, 4000.0) + 0.37) * 2.0 * np.pi * 1e-4  # no angle of a resonance
    q = np.exp(-1j * theta)
    R = np.asarray(held_beat.response(HeldBeat(whole, jnp.asarray(rate)), q))
    R_0 = seen_at_once(whole, rate, q)
    known = np.array([375.0, 810.0, 1900.0])
    gains, K2 = held(design(FAMILY), FAMILY.K2, jnp.asarray(known))
    for i, K_s in enumerate(known):
        one, contact = jax.tree.map(lambda leaf, i=i: leaf[i], gains), contact_of(0.94 * K_s, K2[i], path)
        without, with_it = (
            np.asarray(loop_response(one, contact, theta, 0.0, held=beat))
            for beat in (None, HeldBeat(whole, jnp.asarray(rate)))
        )
        by_R = (with_it - without) / R
        for used in (0.25, 0.5, 0.75):
            partly = without + by_R * used * R / (1.0 + (1.0 - used) * R_0)
            assert np.max(1.0 / np.abs(1.0 + partly)) < 2.0


@pytest.mark.oracle
def test_on_the_arm_it_takes_a_third_of_what_a_regular_heart_leaves() -> None:
    """20 s after 12 s; chatter stays."""
    base = Experiment.published("family-wam")
    motion = changed(base.motion, kind="rhythm", rhythm="variability", phases="random", seed=11)
    experiment = changed(base, stiffness=(1900.0,), motion=motion)
    nothing = replace(FAMILY, listening=replace(FAMILY.listening, harmonics=0))
    learns, does_not = (evaluate(each, experiment).metrics for each in (FAMILY, nothing))
    assert np.all(learns.rms < 0.75 * does_not.rms)
    assert np.all(learns.true_rms < 0.75 * does_not.true_rms)
    assert np.max(learns.chatter) < 1.02 * np.max(does_not.chatter)


@pytest.mark.parametrize(("key", "value"), [("harmonics", 17), ("harmonics", 2.5), ("harmonics", True), ("beats", 0.5)])
def test_a_wrong_setting_is_refused_by_name(key: str, value: Any) -> None:
    listening = {**FAMILY.to_dict()["listening"], key: value}
    with pytest.raises(InputError, match=f"listening.{key}"):
        Params.from_dict({**FAMILY.to_dict(), "listening": listening})


def test_no_harmonics_learn_nothing() -> None:
    assert constants_of(0, 2.5, T_s) is None
    nothing = replace(FAMILY, listening=replace(FAMILY.listening, harmonics=0))
    assert design(nothing).schedule.repetition is None
