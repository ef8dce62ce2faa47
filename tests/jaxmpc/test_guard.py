"""The guard of the loop's gain: against scipy's filters, the response in closed form, and on arms with soft cables."""

import math
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from msgspec.structs import replace

from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc import Experiment, InputError, Params, design, evaluate
from jaxmpc.law import cascade, gain_backoff, schedule
from jaxmpc.law.gains import Gains, backed_off, constant_reference, with_gain
from jaxmpc.law.ops import FLOATS
from jaxmpc.stability.controller import controller_response
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.xla import ops
from jaxmpc.xla.precision import in_float64
from tuning.trials import HARD, Job, run

T_S = 1e-3
GUARD = gain_backoff.constants(T_S, math)


def swinging(seconds: float = 0.8) -> np.ndarray:
    """An error that follows a heart slowly, with a swing that grows and dies away, (samples, 3) [N]."""
    t = np.arange(round(seconds / T_S)) * T_S
    swell = np.exp(-(((t - 0.3) / 0.1) ** 2)) * np.sin(2.0 * np.pi * 35.0 * t)
    slow = np.sin(2.0 * np.pi * 1.2 * t)
    return np.stack([0.2 * slow + swell, 0.1 * slow - 0.5 * swell, 0.3 * slow + 0.2 * swell], 1)


def over(
    error: np.ndarray, held_back: np.ndarray | float = 0.0, dither: np.ndarray | float = 0.0
) -> list[gain_backoff.BackoffMemory]:
    """What is remembered after every sample; limits may hold back commands [m²/s⁴], and a sine may listen [N]."""
    state, found = gain_backoff.init(), []
    held_back, dither = np.broadcast_to(held_back, len(error)), np.broadcast_to(dither, error.shape)
    for sample, held, sine in zip(error.tolist(), held_back.tolist(), dither.tolist(), strict=True):
        state = gain_backoff.step(GUARD, state._replace(held_back=held), sample, FLOATS, sine)
        assert state.held_back == 0.0, "who is told nothing more knows of nothing held back"
        found.append(state.memory)
    return found


def gains_over(error: np.ndarray) -> np.ndarray:
    """g after every sample."""
    return np.array([memory.gain for memory in over(error)])


def test_the_gain_is_that_of_scipys_filters() -> None:
    """The formulas of the module over low-passes P = (1 − p)/(1 − p z⁻¹) and high-passes 1 − P by scipy."""
    error, held_back, dither = swinging(), np.zeros(800), np.zeros((800, 3))
    held_back[20:60] = 1e3
    dither[40:240] = 0.2 * np.sin(2.0 * np.pi * 17.0 * T_S * np.arange(200))[:, None] * [1.0, 0.5, -1.0]
    p, a = math.exp(-gain_backoff.CORNER * T_S), gain_backoff
    alpha, least = 1.0 - math.exp(-T_S / a.MEMORY), a.LEAST

    def mean_square(numerator: list[float], order: int, passed: np.ndarray = error) -> np.ndarray:
        for _ in range(order):
            passed = scipy.signal.lfilter(numerator, [1.0, -p], passed, axis=0)
        found: np.ndarray = scipy.signal.lfilter([alpha], [1.0, alpha - 1.0], np.sum(passed**2, axis=1))
        return found

    swing, drift, heard = mean_square([p, -p], 4), mean_square([1.0 - p], 2), mean_square([], 0, dither)
    seen = swing / (a.NOTICED**2 + swing + drift / 300.0 + heard / 10.0)
    share = scipy.signal.lfilter([T_S / a.PATIENCE], [1.0, T_S / a.PATIENCE - 1.0], seen)
    overload = scipy.signal.lfilter([alpha], [1.0, alpha - 1.0], held_back / (a.HELD_BACK**2 + held_back))
    large, lasting = (swing / (a.LIMIT**2 + drift + heard)) ** 4, (share / a.INSISTENT) ** 16
    g = m = c = 1.0
    expected = []
    for e, f, over_it in zip(large, lasting, (2.0 * overload) ** 4, strict=True):
        at_once = (1.0 - a.PACE * T_S * e / (1.0 + e)) * (1.0 - a.PACE * T_S * over_it / (1.0 + over_it))
        fall = 1.0 - at_once * (1.0 - a.STEADY_PACE * T_S * f / (1.0 + f))
        m += T_S / a.LATELY * (g - m)
        c = c + fall * min(0.0, least + a.BELOW * (m - least) - c) + T_S / a.PROBE * c * (1.0 - c)
        g = least + (1.0 - fall) * (g + T_S / a.RETURN * (c - g) - least)
        expected.append((g, c, m))
    found = over(error, held_back, dither)
    gain = np.array([memory.gain for memory in found])
    assert gain[60] < 0.5, "what is held back acts"
    assert gain.min() < 0.3 * gain[60], "the swing acts"
    # The same sums in another order: a difference of poles near 1 costs scipy's filter some digits.
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("size", [0.5, 5.0], ids=["followed", "not followed"])
def test_a_heart_alone_leaves_the_gain(size: float) -> None:
    """Harmonics up to 8 Hz, as large as where nothing follows the heart, and twice the sensor's noise."""
    t = np.arange(20_000)[:, None] * T_S + np.array([0.0, 0.1, 0.35])
    heart = sum(np.sin(2.0 * np.pi * f * t) / n**2 for n, f in enumerate((1.25, 2.5, 5.0, 8.0), 1))
    noise = 0.02 * np.random.default_rng(0).standard_normal(t.shape)
    swell = np.sin(np.linspace(0.0, 0.5 * np.pi, len(t)))[:, None]
    assert gains_over(size * swell * heart + noise).min() > 0.99


def sine(size: float, hertz: float, seconds: float) -> np.ndarray:
    """A swing of an axis beside the sensor's noise, (samples, 3) [N]."""
    t = np.arange(round(seconds / T_S)) * T_S
    error: np.ndarray = 0.01 * np.random.default_rng(1).standard_normal((len(t), 3))
    error[:, 2] += size * np.sin(2.0 * np.pi * hertz * t)
    return error


@pytest.mark.parametrize("hertz", [25.0, 40.0, 70.0])
def test_a_small_swing_that_lasts_is_noticed_and_a_short_one_is_not(hertz: float) -> None:
    swing = sine(0.1 * math.sqrt(2.0), hertz, 5.0)  # 0.1 N RMS: what counts as swinging
    assert gains_over(swing)[-1] < 0.5
    assert gains_over(swing[:200]).min() > 0.99


def test_a_sine_that_listens_and_its_answer_are_no_swing() -> None:
    """0.3 N at 17 Hz on each axis, answered as strongly, for a second in which nothing frees the error of it."""
    sent = 0.3 * np.sin(2.0 * math.pi * 17.0 * T_S * np.arange(1000))[:, None] * [1.0, 1.0, 1.0]

    def last(dithers: np.ndarray) -> float:
        state = gain_backoff.init()
        for error, dither in zip(sent.tolist(), dithers.tolist(), strict=True):
            state = gain_backoff.step(GUARD, state, error, FLOATS, dither)
        return state.memory.gain

    assert last(sent) > 0.99
    assert last(0.0 * sent) < 0.9


@cache
def recorded() -> Callable[..., Any]:
    """A step of the guard as the robot runs it, a fifth as long: state and error [N] → state and gain."""

    def following(state: gain_backoff.BackoffState, error: Any) -> Any:
        state = gain_backoff.step(GUARD, state, error, OPS)
        return state, state.memory.gain

    return compile_straightline(following, (gain_backoff.init(), (0.0,) * 3)).function


def test_the_recorded_guard_is_the_one_in_plain_floats_to_the_last_bit() -> None:
    state: Any = gain_backoff.init()
    for error, memory in zip(swinging().tolist(), over(swinging()), strict=True):
        state, gain = recorded()(state, error)
        assert gain == memory.gain
    assert gain < 0.9


class Loop(NamedTuple):
    """A swing of one axis that grows above a gain and dies below it."""

    critical: float

    def run(self, seconds: float, event: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Gain, and amplitude [N], of every sample; an event throws the force into a swing at the beginning."""
        step, state, size, found = recorded(), gain_backoff.init(), max(event, 1e-3), []
        for k in range(round(seconds / T_S)):
            state, now = step(state, (0.0, 0.0, size * math.sin(2.0 * math.pi * 35.0 * k * T_S)))
            # 1/s per unit of gain: cable modes have damping ratios of some percent.
            size = max(1e-3, size * math.exp(20.0 * T_S * (now - self.critical)))
            found.append((now, size))
        gain, sizes = np.array(found).T
        return gain, sizes


@pytest.mark.oracle
@pytest.mark.parametrize("critical", [0.8, 0.5, 0.2])
def test_it_stays_below_the_gain_at_which_a_loop_swings_and_seldom_probes(critical: float) -> None:
    gain, sizes = Loop(critical).run(400.0)
    settled = round(20.0 / T_S)
    assert sizes.max() < 1.0
    # Ten seconds as trials judge them: 0.1 N RMS at no time, and in most none of it.
    windows = np.sqrt(np.mean((sizes[settled:].reshape(-1, 10_000) / math.sqrt(2.0)) ** 2, axis=1))
    assert windows.max() < 0.1
    assert np.mean(windows < 0.01) > 0.6
    # It does probe: the gain comes up to where the loop swings, and hardly beyond it.
    assert gain[settled:].max() > critical
    assert gain[settled:].max() < 1.2 * critical


@pytest.mark.oracle
def test_a_stable_loop_has_its_gain_back_minutes_after_an_event() -> None:
    gain, _ = Loop(2.0).run(600.0, event=3.0)
    assert gain.min() < 0.8, "the event made it fall"
    assert 0.5 < gain[round(12.0 / T_S)] < 0.7, "it comes back to the ceiling at once"
    assert gain[-1] > 0.95


def test_what_runs_away_gives_a_number() -> None:
    found = np.array(over(1e9 * swinging(0.2)))
    assert found.min() >= gain_backoff.LEAST


@in_float64
def test_its_slope_is_that_of_central_differences() -> None:
    error = jnp.asarray(swinging(0.4))

    def last(size: jax.Array) -> jax.Array:
        def one(state: gain_backoff.BackoffState, sample: jax.Array) -> tuple[gain_backoff.BackoffState, None]:
            return gain_backoff.step(GUARD, state, tuple(size * sample), ops), None

        start = jax.tree.map(jnp.asarray, gain_backoff.init(0.0 * size))
        return jax.lax.scan(one, start, error)[0].memory.gain

    at, step = 0.2, 1e-5
    slope = float(jax.grad(last)(jnp.asarray(at)))
    difference = (float(last(jnp.asarray(at + step))) - float(last(jnp.asarray(at - step)))) / (2.0 * step)
    assert slope < -0.1
    # Truncation step² g′″/6 with slopes that change over some 0.1: 1e-8 of them.
    assert slope == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize(("order", "designed"), [(1, 1), (3, 1), (1, 2)])
@pytest.mark.parametrize("architecture", ["mpc-aob", "aob"])
@in_float64
def test_a_lower_gain_scales_the_controller_and_nothing_else(architecture: str, order: int, designed: int) -> None:
    """V/Y in closed form, which other tests hold against a state-space model."""
    kind = {"architecture": architecture, "disturbance_order": order, "designed_delay": designed}
    values = {**kind, "Q_p": 10.0**-order}
    gains = jax.tree.map(jnp.asarray, design(Params.from_dict(values)))
    q = jnp.exp(-1j * jnp.geomspace(1e-3, 3.0, 50))
    whole = np.asarray(controller_response(gains, q))
    np.testing.assert_allclose(controller_response(with_gain(gains, 0.3), q), 0.3 * whole, rtol=1e-9)


@pytest.mark.parametrize(("delay", "designed"), [(1, 1), (2, 1), (2, 2)])
@pytest.mark.parametrize("name", ["text", "cautious"])
@in_float64
def test_every_gain_that_is_left_is_stable_on_soft_tissue(name: str, delay: int, designed: int) -> None:
    """Down to the least; scaled alone, without slower integral action, the text design swings slowly."""
    path = replace(Experiment.published("table-1-wam"), delay=delay).loop_path()
    params = Params.from_dict({**Params.published(name).to_dict(), "designed_delay": designed})
    gains = jax.tree.map(jnp.asarray, design(params, force_filter=path.force_filter))

    @partial(jax.jit, static_argnums=0)
    def radius(scaled: Callable[[float], Gains], gain: float, stiffness: float) -> jax.Array:
        less = jax.tree.map(jnp.asarray, scaled(gain), is_leaf=lambda leaf: type(leaf) is tuple)
        return spectral_radius(closed_loop_matrix(less, contact_of(stiffness, params.K2, path)))

    def slower(gain: float) -> Gains:
        return backed_off(gains, gain, ops)

    def lower(gain: float) -> Gains:
        return with_gain(gains, gain)

    tissues = np.geomspace(300.0, 2200.0, 5)[: 5 if name == "cautious" else 3]
    for gain in np.geomspace(gain_backoff.LEAST, 1.0, 9):
        assert max(radius(slower, gain, stiffness) for stiffness in tissues) < 1.0
    assert (radius(lower, 0.25, 375.0) > 1.0) == (name == "text")


class Held(NamedTuple):
    """A frictionless axis of the arm whose acceleration is limited, and so is its change [m/s², and per sample].

    They are those of 50 N·m, and 10 N·m a sample, of the second joint.
    """

    gains: Gains
    K2: float
    most: float = 34.0
    step: float = 7.0

    def beat(self, stiffness: float, rise: float, size: float, told: bool) -> tuple[np.ndarray, np.ndarray]:
        """Force [N] over four seconds in which a heart [m] jumps once, and whether a limit acted; guard told or not."""
        axis, guard = cascade.init(self.gains, 0.0), gain_backoff.init()
        sent = pending = x = speed = believed = before = 0.0
        found = []
        for k in range(4000):
            phase = min(max(k * T_S - 0.5, 0.0), 2.0 * rise) / rise
            force = stiffness * (x - 0.5 * size * (1.0 - math.cos(math.pi * phase)))
            guard = gain_backoff.step(GUARD, guard, (0.0, 0.0, force), FLOATS)
            axis, v = cascade.respond(backed_off(self.gains, guard.memory.gain, FLOATS), axis, force, (0.0,))
            # Two cut-offs as of the published arm's velocities, at 300 rad/s.
            believed, before = believed + (1.0 - math.exp(-0.3)) * ((x - before) / T_S - believed), x
            asked = v - gain_backoff.damping(guard.memory, FLOATS) * self.K2 * believed
            sent = FLOATS.clip(FLOATS.clip(asked, -self.most, self.most), sent - self.step, sent + self.step)
            axis = axis._replace(v=v + sent - asked)
            if told:
                guard = guard._replace(held_back=(sent - asked) ** 2)
            x, speed = x + speed * T_S + 0.5 * pending * T_S**2, speed + pending * T_S
            pending = sent
            found.append((force, sent != asked))
        forces, held = np.array(found).T
        return forces, held


@pytest.fixture(scope="module")
def family() -> Gains:
    """The published family, in plain floats."""

    def floats(node: Any) -> Any:
        if isinstance(node, tuple):
            return type(node)(*map(floats, node)) if hasattr(node, "_fields") else tuple(map(floats, node))
        return None if node is None else floats(tuple(node)) if np.ndim(node) else float(node)

    found: Gains = constant_reference(floats(design(Params.published("family"))))
    return found


@pytest.mark.parametrize("known", [False, True], ids=["fixed gains", "gains for the tissue"])
@pytest.mark.parametrize("stiffness", [375.0, 1150.0, 1900.0])
def test_torques_that_the_limits_hold_come_to_rest(family: Gains, stiffness: float, known: bool) -> None:
    """A heart that jumps by 15 mm in 50 ms asks for more than there is; without friction nothing else ends it."""
    gains, K2 = family._replace(schedule=None), float(Params.published("family").K2)
    if known:
        assert family.schedule is not None
        gains, K2 = schedule.at(family.schedule, math.log(stiffness), FLOATS)
    loop = Held(gains, K2)
    force, held = loop.beat(stiffness, rise=0.05, size=0.015, told=True)
    assert held.any()
    assert not held[-2000:].any()
    assert np.abs(force[-1000:]).max() < 0.05
    _, held = loop.beat(stiffness, rise=0.05, size=0.015, told=False)
    assert held[-1000:].mean() > 0.5 or (stiffness == 375.0 and not known), "it is the guard that ends it"


@pytest.mark.parametrize(("ceiling", "lately", "taken"), [(0.5, 0.4, 0.2), (0.3, 0.45, 0.15), (0.3, 0.3, 0.0)])
def test_what_is_taken_is_the_way_back_to_the_ceiling_or_to_where_it_was(
    ceiling: float, lately: float, taken: float
) -> None:
    assert gain_backoff.taken(gain_backoff.BackoffMemory(0.3, ceiling, lately), FLOATS) == pytest.approx(taken)


def test_the_least_gain_is_without_damping() -> None:
    """From a quarter of the gain on all of it is left."""
    gains = {0.05: 0.0, 0.15: 0.5, 0.25: 1.0, 0.6: 1.0, 1.0: 1.0}
    assert [gain_backoff.damping(gain_backoff.BackoffMemory(g, 1.0, g), FLOATS) for g in gains] == pytest.approx(
        list(gains.values())
    )


@pytest.mark.oracle
@in_float64
def test_damping_that_swings_on_soft_cables_comes_to_rest() -> None:
    """The simulated arm's torques change by 10 N m a sample: with damping at every gain ±50 N m stayed to the end."""
    job = Job((Params.published("family"),), Experiment.published("table-1-wam"), HARD)
    trace = evaluate(job.controllers[0], replace(job.trial(75577), duration=12.0), trace=True).trace
    assert trace is not None
    gain, force = np.asarray(trace.gain)[0, 0], np.asarray(trace.true_force)[0]
    assert gain.min() < 0.1, "the guard had to act"
    assert gain[-1] > 0.3
    assert np.std(force[:, -1000:] - np.mean(force[:, -1000:], 1)[:, None], axis=1).max() < 0.5


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"guarded": 1}, "guarded = 1: must be true or false"),
        ({"guarded": True, "architecture": "mpc"}, 'guarded = True: must be false with the architecture "mpc"'),
    ],
)
def test_a_guard_that_cannot_be_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        Params.from_dict(values)


@pytest.mark.slow
def test_it_holds_arms_whose_cables_swing() -> None:
    """The text design on 100 hard trials, some 60 of which it loses alone; the joints give whatever it asks for."""
    text = Params.published("text")
    guarded = Params.from_dict({**text.to_dict(), "guarded": True})
    lost = run(Job((text, guarded), Experiment.published("table-1-wam").without_limits(), HARD), 100).lost
    assert 3 * lost[:, 1].sum() < lost[:, 0].sum()
    assert not (lost[:, 1] & ~lost[:, 0]).any(), "it loses none that stood without it"
