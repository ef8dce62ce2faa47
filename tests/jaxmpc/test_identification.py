"""The stiffness found while controlling: against scipy's filters, and against the tissue that the loop runs on."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from scipy.signal import lfilter

from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc import Experiment, Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.engine.scenario import scenario_data
from jaxmpc.law import identification
from jaxmpc.law.belief import decide
from jaxmpc.law.gains import Gains
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.stiffness import SILENT, UNHEARD, Alarm, unknown
from jaxmpc.loop import linear
from jaxmpc.loop.linear import start
from jaxmpc.stability.loop import contact_of
from jaxmpc.world.contact import Contact, ContactState, sense
from jaxmpc.world.quantise import quantise

pytestmark = pytest.mark.once

FAMILY = Params.published("family")
T_s = 1e-3
EARLY, WIDTH = np.arange(12.0, 19.0, 1.58), 0.08
"""When beats come early: every other one, as in bigeminy; for how long each pushes [s]."""


def floats(tree: Any) -> Any:
    return jax.tree.map(float, tree)


class Flight(NamedTuple):
    force: np.ndarray
    error: np.ndarray
    tip: np.ndarray
    stiffness: np.ndarray
    authority: np.ndarray
    listening: np.ndarray
    width: np.ndarray


@pytest.fixture(scope="module")
def gains() -> Gains:
    found: Gains = floats(scalars(design(FAMILY), preview=False))
    return found


def sampled(law: Gains, world: Contact, carry: Any, met: Any, force: Any, wanted: Any, stiffness: Any, ops: Any) -> Any:
    """A sample of the loop whose sensor says so much, and what a flight keeps of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear, "quantise", lambda *_: force)
        now = linear.AxisSignals(met, 0.0, (wanted,), 1.0)
        carry, sample = linear.advance(law, world._replace(stiffness=stiffness), 0.0, carry, now, ops)
    known = carry.controller.tissue
    return carry, (
        *(sample.force, sample.force - wanted, sample.tip),
        *(known.log_stiffness, known.authority, known.listening, known.width),
    )


def recorded(law: Gains, world: Contact) -> Callable[..., Any]:
    """The same as the robot runs it, a tenth as long; the carry comes and goes as plain tuples."""
    return compile_straightline(
        lambda *inputs: sampled(law, world, *inputs, ops=OPS), (start(law), 0.0, 0.0, 0.0, 0.0)
    ).function


def flat(tree: Any) -> Any:
    """As plain tuples."""
    return tuple(map(flat, tree)) if isinstance(tree, tuple) else tree


@pytest.fixture(scope="module")
def fly(gains: Gains) -> Callable[..., Flight]:
    experiment = Experiment.published("table-1")
    data = scenario_data(experiment)
    heart, noise, wanted = (
        np.asarray(each)[2] for each in (data.signals.heart, data.signals.noise, data.signals.force_ref)
    )
    lsb = float(data.lsb[2])

    def flight(stiffness: Callable[[float], float], seconds: float, law: Gains = gains, push: float = 0.0) -> Flight:
        """Z of Table I on the linear loop, with the tissue's stiffness a function of time [s].

        Beats come early at `EARLY`; a tip that stands still would be pushed by so much [N].
        """
        world = floats(contact_of(stiffness(0.0), FAMILY.K2, experiment.loop_path()))
        times = T_s * np.arange(round(seconds / T_s))
        begun = (times[:, None] - EARLY) / WIDTH
        beats = np.sum(np.where((begun > 0.0) & (begun < 1.0), 1.0 - np.cos(2.0 * np.pi * begun), 0.0), axis=1)
        pushed = (heart[: len(times)] + 0.5 * push / stiffness(0.0) * beats).tolist()
        sample, carry, rows = recorded(law, world), flat(start(law)), []
        for k, met in enumerate(pushed):
            world = world._replace(stiffness=stiffness(k * T_s))
            clean, _ = sense(world, ContactState(*carry[1]), met)
            force = quantise(clean + float(noise[k]), lsb, FLOATS)
            carry, seen = sample(carry, met, force, float(wanted[k, 0]), world.stiffness)
            rows.append(seen)
        force, error, tip, log_stiffness, *belief = np.array(rows).T
        return Flight(force, error, tip, np.exp(log_stiffness), *belief)

    return flight


def test_a_flight_is_the_loop_in_plain_floats_to_the_last_bit(gains) -> None:
    world = floats(contact_of(810.0, FAMILY.K2, Experiment.published("table-1").loop_path()))
    sample, ours, theirs = recorded(gains, world), flat(start(gains)), start(gains)
    for k, force in enumerate(-5.0 + np.random.default_rng(0).standard_normal(300)):
        met = 1e-3 * np.sin(0.01 * k), float(force), -5.0, 810.0 + k
        (ours, seen), (theirs, wanted) = sample(ours, *met), sampled(gains, world, theirs, *met, ops=FLOATS)
        assert seen == wanted
        assert ours == flat(theirs)


@pytest.mark.oracle
@pytest.mark.parametrize("stiffness", [375.0, 700.0, 1900.0])
def test_it_finds_the_tissue_within_four_seconds_and_knows_how_well(fly, stiffness) -> None:
    flown = fly(lambda t: stiffness, 8.0)
    settled = slice(4000, None)
    assert np.all(np.abs(flown.stiffness[settled] / stiffness - 1.0) < 0.02)
    assert np.all(flown.authority[4500:] == 1.0)
    # The sine goes off again, and what is left of the force is less than under the gains for every tissue.
    assert np.all(flown.listening[5500:] == 0.0)
    assert np.std(flown.error[6000:]) < 0.35 * np.std(flown.error[1000:2500])


def test_the_lock_in_is_what_scipy_makes_of_the_same_signals(gains, fly) -> None:
    flown, constants = fly(lambda t: 810.0, 2.0), gains.schedule.identification
    on = np.clip(1e3 * np.concatenate([[0.0], flown.listening[:-1]]), 0.0, 1.0)
    angle = np.arctan2(constants.turn[1], constants.turn[0])
    mixer = np.exp(-1j * angle * np.arange(1, len(on) + 1))
    share = constants.mixing

    def heard(signal: np.ndarray) -> np.ndarray:
        mixed = on * np.diff(signal, prepend=0.0) * mixer
        for _ in range(3):
            mixed = lfilter([share], [1.0, share - 1.0], mixed)
        return mixed

    Y, X = heard(flown.force), heard(flown.tip)
    # Where it is sure, K̂ follows this quotient; at 2 s it has had half a second for it.
    expected = (Y * X.conj()).real / (np.abs(X) ** 2 + identification.TIP_FLOOR)
    state = unknown(constants, flown.force[0])
    for k, (force, tip) in enumerate(zip(flown.force, flown.tip, strict=True)):
        state = state._replace(listening=flown.listening[k - 1] if k else 0.0)
        state, found, lead = identification._listen(constants, state, force, tip, FLOATS)
    assert found == pytest.approx(expected[-1], rel=1e-9)
    assert found == pytest.approx(810.0, rel=0.02)
    assert lead == pytest.approx((Y * X.conj())[-1].imag / (Y * X.conj())[-1].real, rel=1e-6)


def test_all_that_is_heard_is_what_scipy_makes_of_the_same_signals(gains) -> None:
    """With the sine, the control and pushes of other axes coming and going as no flight has it."""
    constants = gains.schedule.identification
    t, random = T_s * np.arange(6000), np.random.default_rng(8)
    listening = np.interp(t, [0.2, 1.2, 3.0, 3.5, 4.5, 5.0], [0.0, 1.0, 1.0, 0.3, 0.3, 0.0])
    authority = np.interp(t, [0.0, 2.0, 3.0, 6.0], [0.0, 0.0, 1.0, 0.4])
    others = np.select([t < 1.5, t < 4.0], [0.0, 1.1 * 0.09**2], 0.02)
    angle = 2.0 * np.pi * 17.0 * T_s * np.arange(1, 6001)
    tip = 2e-4 * np.sin(angle) + 1e-4 * np.sin(2.0 * np.pi * 1.2 * t) + 1e-6 * random.standard_normal(6000)
    force, wanted = 700.0 * tip - 5.0 + 0.02 * random.standard_normal(6000), -5.0 + 0.05 * np.sin(t) - 0.3 * (t > 5.0)
    force += 0.004 * np.cos(angle)

    def low_pass(share: float, signal: np.ndarray) -> np.ndarray:
        found: np.ndarray = lfilter([share], [1.0, share - 1.0], signal)
        return found

    def mixed(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        on = np.clip(1e3 * listening, 0.0, 1.0)
        once = low_pass(constants.mixing, on * np.diff(signal, prepend=signal[0]) * np.exp(-1j * angle))
        twice = low_pass(constants.mixing, once)
        return twice, low_pass(constants.mixing, twice)

    (Y2, Y), (X2, X) = mixed(force), mixed(tip)
    stiffness = (Y * X.conj()).real / (np.abs(X) ** 2 + 1e-18)
    rest = low_pass(constants.averaging, np.abs(Y2 - Y - stiffness * (X2 - X)) ** 2)
    heard = low_pass(constants.averaging, listening)
    width = constants.confidence * np.sqrt(1.5 * (rest + 1e-12) / (heard * np.abs(Y) ** 2 + 1e-12))
    answer = 2.0 * (Y * np.exp(1j * angle) / (1.0 - np.exp(-2j * np.pi * 17.0 * T_s))).real
    error = force - answer - wanted
    upset, strain = low_pass(T_s / 0.1, error**2), low_pass(T_s / 1.0, error**2)
    # A filter of fading memory predicts a parabola whole, and has its poles at one place.
    pole = np.exp(-T_s / 0.0035)
    missed = lfilter(np.poly([1.0] * 3), np.poly([pole] * 3), force - force[0])
    burst, noise, expected = low_pass(T_s / 0.03, missed**2), 0.0, []
    for k, e in enumerate(missed):
        push = np.clip(4.0 * max(strain[k - 1] if k else 0.0, others[k]) / 0.09**2 - 4.0, 0.0, 1.0)
        noise += min(constants.watching * (1.0 + 20.0 * (1.0 - authority[k]) * push), 0.5) * (e * e - noise)
        expected.append((noise, burst[k], upset[k], strain[k], rest[k], heard[k], min(width[k], 10.0), answer[k]))

    state, found = unknown(constants, force[0])._replace(last=(force[0], tip[0])), []
    for k in range(6000):
        state = state._replace(listening=listening[k], authority=authority[k], unrest=0.0)
        around = Alarm(0.0, others[k])
        state = identification.step(constants, state, force[k], tip[k], wanted[k], 0.0, around, FLOATS)
        of_wave = identification.dither(constants, state._replace(listening=listening[k]))
        assert of_wave == pytest.approx(constants.amplitude * listening[k] * np.sin(angle[k]), abs=1e-9)
        of_state = state.noise, state.burst, state.upset, state.strain, state.rest, state.heard, state.width
        found.append((*of_state, identification.answer(constants, state)))
    assert np.median(width[2000:3000]) < 0.1, "the sine is heard"
    assert strain[4900] < 0.09**2 < strain[-1], "the push is of other axes first, then its own"
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


def test_a_wave_that_has_shrunk_or_grown_comes_back(gains) -> None:
    """Rounding would have it so over hours; the angle stays what it is."""
    for size in (0.98, 1.02):
        state = unknown(gains.schedule.identification, 0.0)._replace(wave=(0.6 * size, 0.8 * size))
        for _ in range(3):
            state, *_ = identification._listen(gains.schedule.identification, state, 0.0, 0.0, FLOATS)
        assert np.hypot(*state.wave) == pytest.approx(1.0, abs=1e-12)


def test_the_answer_to_the_sine_is_told_apart_from_the_rest_of_the_force(gains) -> None:
    constants = gains.schedule.identification
    state, angle = unknown(constants, 0.0), np.arctan2(constants.turn[1], constants.turn[0])
    left = []
    for k in range(8000):
        force = -5.0 + 0.2 * np.sin(angle * k + 0.7)
        state = state._replace(listening=1.0)
        state, *_ = identification._listen(constants, state, force, 0.0, FLOATS)
        left.append(force - identification.answer(constants, state))
    # Sixteen time constants of a triple pole leave 1e-4 of what the step at the start left in the filters.
    np.testing.assert_allclose(left[-1000:], -5.0, atol=1e-3)


def to(before: float, after: float) -> Callable[[float], float]:
    """A stiffness that changes at 12 s within 0.2 s."""
    return lambda t: before + (after - before) * min(max(5.0 * (t - 12.0), 0.0), 1.0)


@pytest.mark.oracle
@pytest.mark.parametrize(("before", "after"), [(810.0, 1860.0), (400.0, 1600.0), (500.0, 950.0)])
def test_a_tissue_that_stiffens_is_noticed_and_found_again(fly, before, after) -> None:
    """Beyond twice the stiffness the loop is unstable, and the schedule goes at once; below, it is heard to ring."""
    flown = fly(to(before, after), 22.0)
    assert np.max(np.abs(flown.error[4000:])) < 1.0
    assert np.max(flown.listening[12_000:16_000]) > 0.5
    assert after < 2.0 * before or np.min(flown.authority[12_000:12_500]) == 0.0
    assert flown.stiffness[-1] == pytest.approx(after, rel=0.05)


@pytest.mark.oracle
def test_a_tissue_that_stiffens_slowly_is_noticed_before_the_loop_is_unstable(fly) -> None:
    """Three times in 8 s. A watch that learns the ringing as usual lets the force swing by 1.6 N here."""
    flown = fly(lambda t: 600.0 * 3.0 ** min(max((t - 10.0) / 8.0, 0.0), 1.0), 25.0)
    assert np.max(np.abs(flown.error[4000:])) < 0.6
    assert flown.stiffness[-1] == pytest.approx(1800.0, rel=0.05)
    assert flown.authority[-1] == 1.0


@pytest.mark.oracle
def test_a_second_change_is_heard_as_the_first(fly) -> None:
    def twice(t: float) -> float:
        first, second = (min(max(5.0 * (t - begin), 0.0), 1.0) for begin in (6.0, 17.0))
        return 400.0 + 500.0 * first + 1100.0 * second

    flown = fly(twice, 25.0)
    assert np.max(np.abs(flown.error[4000:])) < 1.0
    assert flown.stiffness[16_000] == pytest.approx(900.0, rel=0.05)
    assert np.max(flown.listening[6000:7000]) > 0.5
    assert np.min(flown.authority[17_000:17_500]) == 0.0
    assert flown.stiffness[-1] == pytest.approx(2000.0, rel=0.05)


@pytest.mark.oracle
def test_a_tissue_that_softens_never_costs_the_force(fly) -> None:
    """Too low a gain is stable here, so it may go unnoticed: no more is asked than that the force stays."""
    flown = fly(to(1400.0, 450.0), 22.0)
    assert np.max(np.abs(flown.error[4000:])) < 2.0
    assert np.std(flown.error[14_000:]) < 0.25


@pytest.mark.oracle
def test_a_tissue_that_stays_is_not_doubted(fly) -> None:
    flown = fly(lambda t: 1250.0, 24.0)
    assert np.all(flown.listening[6000:] == 0.0)


@pytest.mark.oracle
@pytest.mark.parametrize(("stiffness", "push"), [(375.0, 2.3), (1250.0, 3.0)])
def test_early_beats_in_a_row_take_the_control_for_moments_alone(fly, stiffness, push) -> None:
    flown = fly(lambda t: stiffness, 20.0, push=push)
    held = [flown.authority[round(beat / T_s) :] for beat in EARLY]
    assert sum(np.min(after[:250]) < 0.2 for after in held) >= 3
    assert all(np.min(after[900:1500]) == 1.0 for after in held)
    # The sine hardly begins: with it, it would take seconds.
    assert np.max(flown.listening[6000:]) < 0.2


def test_tissue_that_damps_is_left_to_the_fixed_gains(gains) -> None:
    """Of 810 N/m with 2.5 N s/m: at 17 Hz the force leads by 0.33; known well, it still is no spring."""
    constants, omega = gains.schedule.identification, 2.0 * np.pi * 17.0

    def authority_after(viscosity: float) -> float:
        state, narrowest = unknown(constants, 0.0), UNHEARD
        for k in range(8000):
            tip = 1e-4 * np.sin(omega * k * T_s)
            force = 810.0 * tip + viscosity * 1e-4 * omega * np.cos(omega * k * T_s)
            state = identification.step(constants, state, force, tip, 0.0, 0.0, SILENT, FLOATS)
            narrowest = min(narrowest, state.width)
        assert narrowest < 0.5 * constants.band
        return float(state.authority)

    assert authority_after(0.0) == 1.0
    assert authority_after(2.5) == 0.0


def test_where_nothing_can_be_heard_the_fixed_gains_hold(gains, fly) -> None:
    """A sine of 2 mN drowns: the width stays large, and K̂ and the authority where they were."""
    family = gains.schedule
    quiet = family._replace(identification=family.identification._replace(amplitude=0.002))
    flown = fly(lambda t: 810.0, 8.0, gains._replace(schedule=quiet))
    assert np.all(flown.authority == 0.0)
    assert np.min(flown.width[2000:]) > family.identification.band


@pytest.mark.oracle
def test_a_sine_that_finds_nothing_goes_off_and_tries_again(gains, fly) -> None:
    """Twelve seconds' worth, forgotten to 0.6 with a time constant of 60 s: then it is on for some 6 s in 40."""
    family = gains.schedule
    quiet = family._replace(identification=family.identification._replace(amplitude=0.002))
    flown = fly(lambda t: 810.0, 24.0, gains._replace(schedule=quiet))
    assert np.all(flown.listening[1000:11_000] == 1.0)
    assert np.all(flown.listening[15_000:] == 0.0)

    constants, state, sounding = family.identification, unknown(family.identification, 0.0), []
    for _ in range(180_000):
        state = decide(constants, state, 1.0, 0.0, 0.0, SILENT, FLOATS)
        sounding.append(state.listening)
    heard = np.array(sounding[40_000:])
    assert 0.1 < np.mean(heard) < 0.25
    # It is on or off, and hardly ever in between: nothing weak sounds for ever.
    assert np.mean((heard > 0.01) & (heard < 0.99)) < 0.04
    assert np.sum(np.diff(heard > 0.5)) >= 6


def test_a_schedule_under_which_a_guard_took_gain_back_is_trusted_again_within_minutes(gains) -> None:
    constants = gains.schedule.identification
    state = unknown(constants, 0.0)._replace(authority=1.0)
    for _ in range(2000):
        state = decide(constants, state, 810.0, 0.0, 0.5, SILENT, FLOATS)
    assert state.authority == 0.0
    assert 0.2 < state.trust < 0.5
    # Known all the time: it never has more than it is trusted with.
    least = state.trust
    for _ in range(100_000):
        state = state._replace(width=0.0, heard=1.0, log_stiffness=np.log(810.0))
        state = decide(constants, state, 810.0, 0.0, 0.0, SILENT, FLOATS)
        assert state.authority <= state.trust
    assert state.trust == pytest.approx(1.0 - (1.0 - least) * np.exp(-100.0 / 150.0), rel=1e-3)
    assert state.authority == pytest.approx(state.trust, rel=1e-4)
