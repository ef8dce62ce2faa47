"""Margins of a family that learns the beat are the worst over angles and over rates of the heart."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, Params, Status, design
from jaxmpc.stability import Margins, worst_of
from jaxmpc.stability.crossings import search_angles
from jaxmpc.stability.family import family_margins, held, judged_where
from jaxmpc.stability.held_beat import HeldBeat, spread_rates
from jaxmpc.stability.loop import closed_loop_matrix, contact_of
from jaxmpc.stability.response import loop_response

pytestmark = pytest.mark.once

FAMILY = Params.published("family")
RATES = 12
PATH = Experiment.published("family-wam").loop_path()


def learning(**settings: Any) -> Params:
    """The published family that learns in another way."""
    assert FAMILY.listening is not None
    return replace(FAMILY, listening=replace(FAMILY.listening, **settings))


@pytest.mark.oracle
def test_margins_that_learn_are_the_worst_of_a_dense_search() -> None:
    """Every rate, and 0.1 Hz between angles: a resonance is 0.2 Hz wide and more."""
    known, ratios = np.array([375.0]), np.array([0.94, 1.06])
    found = family_margins(FAMILY, known, ratios, PATH, partial(spread_rates, count=RATES))
    gains, K2 = held(design(FAMILY), FAMILY.K2, jnp.asarray(known))
    one = jax.tree.map(lambda leaf: leaf[0], gains)
    learning = design(FAMILY).schedule.repetition
    theta = jnp.asarray(np.union1d(np.arange(1, 5000) * 2.0 * np.pi * 1e-4, np.asarray(search_angles())))

    @jax.jit  # a program instead of one for each operation
    def judged(contact: Any, beat: HeldBeat | None) -> Any:
        answers = [loop_response(one, contact, theta, cut, held=beat) for cut in (0.0, 1.0)]
        return answers, closed_loop_matrix(one, contact, beat)

    for i, ratio in enumerate(ratios):
        contact = contact_of(known[0] * ratio, K2[0], PATH.with_cutoff(FAMILY.velocity_cutoff))
        peaks, lags = [], []
        for rate in [None, *np.geomspace(learning.finder.least, learning.finder.most, RATES)]:
            answers, matrix = judged(contact, None if rate is None else HeldBeat(learning, jnp.asarray(rate)))
            peaks.append(max(float(jnp.max(1.0 / jnp.abs(1.0 + L))) for L in answers))
            lags += [smallest_lag(np.asarray(L)) for L in answers]
            assert np.max(np.abs(np.linalg.eigvals(np.asarray(matrix)))) < 1.0
        assert float(found.M_s[0, i]) == pytest.approx(max(peaks), rel=1e-3)
        assert float(found.phase_margin_deg[0, i]) == pytest.approx(min(lags), abs=0.05)


def smallest_lag(L: np.ndarray) -> float:
    """Over all crossings of the unit circle; between neighbours angle and logarithm count as straight [deg]."""
    size = np.log(np.abs(L))
    at = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    angle = np.angle(L[at]) + size[at] / (size[at] - size[at + 1]) * np.angle(L[at + 1] / L[at])
    return float(np.degrees(np.min(np.mod(angle + np.pi, 2.0 * np.pi))))


@pytest.mark.oracle
@pytest.mark.parametrize(("beats", "hertz"), [(2.5, 2.1544), (5.0, 1.7852), (5.0, 1.3)])
def test_crossings_beside_a_resonance_are_found(beats: float, hertz: float) -> None:
    """A learned harmonic is a pole of L on the unit circle, beside which it crosses the real axis within some mHz."""
    family, K_s, rate = learning(beats=beats), 0.94 * 375.0, 2.0 * np.pi * hertz
    found = family_margins(family, [375.0], [0.94], PATH, lambda _: jnp.array([rate]))
    gains, K2 = held(design(family), family.K2, jnp.array([375.0]))
    one = jax.tree.map(lambda leaf: leaf[0], gains)
    constants = design(family).schedule.repetition
    contact = contact_of(K_s, K2[0], PATH.with_cutoff(family.velocity_cutoff))
    poles = rate * float(constants.finder.T_s) * np.arange(1, len(constants.gains) + 1)
    away = np.geomspace(1e-7, 0.02, 400)
    theta = np.unique([*np.geomspace(1e-5, np.pi, 20_000), *np.ravel(poles[:, None] + np.append(-away, away))])
    theta = theta[(theta > 0.0) & (theta < np.pi)]
    levels = []
    for cut in (0.0, 1.0):
        for beat in (None, HeldBeat(constants, jnp.asarray(rate))):
            L = np.asarray(loop_response(one, contact, jnp.asarray(theta), cut, held=beat))
            at = np.flatnonzero(L.imag[:-1] * L.imag[1:] < 0.0)
            # From one side of a pole to the other the curve is torn.
            at = at[np.abs(theta[at, None] + 0.5e-7 - poles).min(axis=1) > 1e-7]
            share = L.imag[at] / (L.imag[at] - L.imag[at + 1])
            levels += [*(L.real[at] + share * (L.real[at + 1] - L.real[at]))]
    outside = max(level for level in levels if level <= -1.0)
    assert float(found.gain_reduction_db[0, 0]) == pytest.approx(20.0 * np.log10(-outside), abs=1e-3)


@pytest.mark.oracle
def test_the_published_family_keeps_its_margins_at_rates_between() -> None:
    known, _ = judged_where(FAMILY.listening, 7)
    found = family_margins(FAMILY, known, np.array([0.94, 1.06]), PATH, partial(spread_rates, count=25))
    assert np.max(found.M_s) <= 2.0
    assert np.min(found.gain_margin_db) >= 6.0
    assert np.min(found.gain_reduction_db) >= 4.0
    assert np.min(found.phase_margin_deg) >= 30.0
    assert np.min(found.delay_margin_s) >= 1.5e-3
    assert np.max(found.spectral_radius) < 1.0


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(learning(beats=5.0), id="slowly", marks=pytest.mark.oracle),
        pytest.param(FAMILY, id="published", marks=pytest.mark.oracle),
        pytest.param(learning(beats=1.0), id="in a beat", marks=pytest.mark.oracle),
        pytest.param(learning(harmonics=4), id="4 harmonics", marks=pytest.mark.slow),
        pytest.param(learning(harmonics=12), id="12 harmonics", marks=pytest.mark.oracle),
    ],
)
def test_no_rate_of_a_fine_grid_tells_more(family: Params) -> None:
    """Of 28 families around the published one 160 rates told 0.009 dB more at most, where 12 alone left 0.055."""
    at = np.array([375.0, 1240.0]), np.array([0.94, 1.06]), PATH
    told, dense = family_margins(family, *at), family_margins(family, *at, partial(spread_rates, count=100))
    for name, room in (("gain_margin_db", 1e-3), ("gain_reduction_db", 0.01), ("phase_margin_deg", 2e-3)):
        assert (np.min(getattr(told, name), axis=1) <= np.min(getattr(dense, name), axis=1) + room).all(), name
    assert (np.max(told.M_s, axis=1) >= np.max(dense.M_s, axis=1) - 1e-4).all()


def test_a_rate_that_is_told_counts_and_no_other() -> None:
    """The rates that a search is given are all it has; the worst is found for whoever gives none."""
    at = np.array([375.0]), np.array([0.94]), PATH
    slow = family_margins(FAMILY, *at, lambda one: one.finder.least[None])
    assert slow.gain_reduction_db > family_margins(FAMILY, *at).gain_reduction_db + 0.3


@pytest.mark.oracle
def test_the_worst_over_rates_is_that_of_each_margin() -> None:
    """The first learns nothing and tells the radius, unless a loop that learns is unstable; what is no number stays."""
    stable = Margins(
        M_s=jnp.array([1.8, 1.9, 1.7]),
        gain_margin_db=jnp.array([7.0, 6.0, 8.0]),
        gain_reduction_db=jnp.array([jnp.inf, 5.0, 4.0]),
        phase_margin_deg=jnp.array([33.0, 31.0, 32.0]),
        delay_margin_s=jnp.array([3e-3, 2e-3, 4e-3]),
        spectral_radius=jnp.array([0.98, 0.9999, 0.99]),
        status=jnp.array([Status.OK] * 3),
    )
    assert worst_of(stable) == (1.9, 6.0, 4.0, 31.0, 2e-3, 0.98, Status.OK)
    lost = stable._replace(
        M_s=jnp.array([1.8, jnp.inf, 1.7]),
        gain_margin_db=jnp.array([7.0, jnp.nan, 8.0]),
        spectral_radius=jnp.array([0.98, 1.01, 0.99]),
        status=jnp.array([Status.OK, Status.UNSTABLE, Status.OK]),
    )
    found = worst_of(lost)
    assert (found.M_s, found.spectral_radius, found.status) == (np.inf, 1.01, Status.UNSTABLE)
    assert np.isnan(found.gain_margin_db)
