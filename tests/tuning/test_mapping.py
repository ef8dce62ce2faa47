"""Space mapping: exact where it was measured, its search against another solver, and a kill in between."""

from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

from jaxmpc.experiment import Experiment
from jaxmpc.metrics import Metrics
from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec
from tuning.objective.evaluated import HEADROOM
from tuning.objective.loss import Values, value_alone
from tuning.objective.measures import Data
from tuning.objective.problem import Problem, over_starts, problem_of, training
from tuning.proof.gradients import _of_loss, on_tissue, slopes
from tuning.search.constraints import Constraints, programs_of
from tuning.search.corrected import REACH, minimised
from tuning.search.mapping import Measured, corrected_at, correction, parents, refine, spectra_of
from tuning.search.state import SearchState

MOVED = (0, 1, 2, 3, 4, 5)
"""All but the horizons, which come last."""


class Case(NamedTuple):
    """A job whose linear runs measure, quickly, and whose spectra propose."""

    spec: TuneSpec
    met: list[Experiment]
    measuring: Problem
    spectra: Problem
    z: np.ndarray
    """Points about the given parameters, damped enough to be stable everywhere."""
    measured: Values
    factors: Metrics


@pytest.fixture(scope="module")
def case() -> Case:
    spec = TuneSpec.from_dict(
        {
            "experiment": {"published": "table-1", "damping": "sampled"},
            "tune": {"duration": 4.0, "settle": 2.5, "train_seeds": [0], "margin_points": 0},
            "goals": {
                "M_s": 3.0,
                "gain_margin_db": 4.0,
                "rms": 0.075,
                "soft": {"rms_ratio": 0.65, "peak_to_peak_ratio": 0.7},
            },
        }
    )
    z = np.tile(spec.space.encode(spec.params), (4, 1))
    z[:, spec.space.names.index("K2")] += 1.0
    z += 0.1 * np.random.default_rng(1).standard_normal(z.shape)

    @in_float64
    def made() -> Case:
        met = training(spec, spec.tune.train_seeds)
        measuring = problem_of(spec, met)
        spectra = spectra_of(spec, problem_of(spec, met, spectral=True), measuring.data.reference)
        measured = measuring.evaluate(z)
        return Case(
            spec, met, measuring, spectra, z, measured, correction(measured.cells, spectra.cells(z, np.ones(4, bool)))
        )

    return made()


@pytest.mark.slow
@in_float64
def test_corrected_spectra_say_at_a_point_what_was_measured_there(case: Case) -> None:
    """Loss and every goal to rounding; and without the correction they do not."""
    assert np.abs(case.factors.peak_to_peak - 1.0).min() > 1.0
    for i in range(len(case.z)):
        one: Any = jax.tree.map(lambda field, i=i: np.repeat(field[i : i + 1], 4, axis=0), case.factors)
        said = jax.jit(value_alone, static_argnames="structure")(
            case.z, limited(case, 4, one), 1.0, structure=case.spectra.structure
        )
        for name in ("loss", "hard", "soft"):
            found, expected = getattr(said, name), getattr(case.measured, name)
            np.testing.assert_allclose(found[i], expected[i], rtol=1e-12)


@pytest.mark.slow
@in_float64
def test_what_is_corrected_at_a_point_holds_for_each_tissue_alone(case: Case) -> None:
    measured = Measured(case.z, case.measured.loss, case.factors)
    for i, tissue in ((1, 0), (3, 2)):
        corrected = on_tissue(corrected_at(case.spectra, measured, case.z[i]), tissue)
        runs = on_tissue(case.measuring, tissue).evaluate(case.z)
        np.testing.assert_allclose(corrected.evaluate(case.z).score[i], runs.score[i], rtol=1e-12)


def evaluated(case: Case, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Risk and constraints of each point as its own run corrects them, with their slopes."""
    z = case.z.copy()
    z[:, list(MOVED)] = x
    seen = Constraints(case.spectra, len(z))(z, case.factors)
    return seen.values, seen.slopes


def limited(case: Case, rows: int, factors: Metrics) -> Data:
    """The spectra's data with a correction, and limits for so many points."""
    data = case.spectra.data
    margins, hard = jax.tree.map(lambda limit: np.full(rows, float(limit)), (data.margins, data.hard))
    return data._replace(margins=margins, hard=hard, correction=factors)


@pytest.mark.oracle
@in_float64
def test_goals_at_a_point_are_what_was_measured_there_with_slopes_that_are_central_differences(case: Case) -> None:
    """Step 1e-5: rounding and curvature leave some 1e-8 of the largest slope."""
    h, z = 1e-5, case.z[1]
    sides = [z + sign * h * np.eye(len(z))[i] for i in MOVED for sign in (1, -1)]
    problem = corrected_at(case.spectra, Measured(case.z, case.measured.loss, case.factors), z)
    found = slopes(problem, z, len(case.z), np.stack(sides))
    assert [*found] == ["score", "M_s", "gain_margin_db", "rms"]
    reached = np.concatenate([case.measured.score[1:2], case.measured.hard[1]])
    # A margin's is that of the first stiffness, the rest are those of the worst.
    worst = [True, False, False, True]
    np.testing.assert_allclose(np.array([one.value for one in found.values()])[worst], reached[worst], rtol=1e-12)
    for name, slope in found.items():
        expected = np.log(slope.beside[::2] / slope.beside[1::2]) / (2.0 * h)
        scale = np.abs(expected).max()
        assert scale > 1e-2, name
        np.testing.assert_allclose(slope.gradient[list(MOVED)] / scale, expected / scale, atol=1e-6, err_msg=name)


@pytest.mark.slow
@in_float64
def test_the_searchs_programs_give_the_slopes_that_a_gradient_of_the_loss_gives(case: Case) -> None:
    """The proof compiles nothing. Of the loss it takes differences of numbers 1e4 times as large, hence 1e-8."""
    # What another test has compiled would hide what this one does not.
    over_starts.cache_clear()
    programs_of.cache_clear()
    measured, rows = Measured(case.z, case.measured.loss, case.factors), len(case.z)
    z, others = case.z[1], case.z[2:]
    for tissue in range(len(case.spec.experiment.stiffness)):
        corrected = on_tissue(corrected_at(case.spectra, measured, z), tissue)
        found = slopes(corrected, z, rows, others)
        assert [each.programs for each in programs_of(case.spectra.structure)] == [1, 1]
        assert over_starts.cache_info().currsize == 0
        if tissue == 1:
            expected = _of_loss(corrected, z, rows, others)
            over_starts.cache_clear()
            assert found.keys() == expected.keys() == {"score", "M_s", "gain_margin_db", "rms"}
            for name, slope in expected.items():
                np.testing.assert_allclose(found[name].value, slope.value, rtol=1e-9, err_msg=name)
                np.testing.assert_allclose(found[name].beside, slope.beside, rtol=1e-9, err_msg=name)
                scale = np.abs(slope.gradient).max()
                assert scale > 1e-2, name
                np.testing.assert_allclose(found[name].gradient / scale, slope.gradient / scale, atol=1e-8, rtol=0)


@pytest.mark.oracle
@in_float64
def test_where_a_loop_is_unstable_there_are_no_slopes(case: Case) -> None:
    measured = Measured(case.z, case.measured.loss, case.factors)
    wild = case.z[0].copy()
    wild[case.spec.space.names.index("K2")] -= 30.0
    wild[case.spec.space.names.index("lam")] -= 5.0
    found = slopes(corrected_at(case.spectra, measured, case.z[0]), wild, len(case.z), case.z[:1])
    assert np.isnan(found["score"].value)
    assert np.isposinf([found[name].value for name in ("M_s", "gain_margin_db", "rms")]).all()
    assert all(np.isfinite(slope.beside).all() for slope in found.values())


@pytest.mark.slow
@in_float64
def test_an_evaluation_is_a_look_without_its_gradient(case: Case) -> None:
    again = case.measuring.differentiate(case.z, 1.0)
    assert np.isnan(case.measured.gradient).all()
    for name in ("loss", "score", "M_s", "hard", "soft"):
        np.testing.assert_allclose(getattr(case.measured, name), getattr(again, name), rtol=1e-12, err_msg=name)


@pytest.mark.oracle
@in_float64
def test_slopes_of_risk_and_of_every_constraint_are_central_differences(case: Case) -> None:
    """Step 1e-5: rounding and curvature leave some 1e-8 of the largest slope."""
    h, x = 1e-5, case.z[:, list(MOVED)]
    slopes = evaluated(case, x)[1]
    sides = [np.stack([evaluated(case, x + sign * h * e)[0] for e in np.eye(len(MOVED))], axis=2) for sign in (1, -1)]
    expected = (sides[0] - sides[1]) / (2.0 * h)
    assert slopes.shape == (len(x), 1 + 2 * len(case.spec.judged_at) + 1, len(MOVED))
    assert np.abs(slopes).max(axis=(0, 2)).min() > 1e-3
    np.testing.assert_allclose(slopes, expected, atol=1e-6 * np.abs(expected).max(), rtol=0)


@pytest.mark.slow
@in_float64
def test_the_search_ends_where_another_solver_does(case: Case) -> None:
    """An interior-point method from the same place: log risks to 2e-3, less than a correction is good for."""
    z, moved = case.z[0], list(MOVED)
    whole = minimised(case.spectra, case.z, case.factors)
    np.testing.assert_array_equal(np.delete(whole, moved, axis=1), np.delete(case.z, moved, axis=1))
    values, before = evaluated(case, whole[:, moved])[0], evaluated(case, case.z[:, moved])[0]
    assert values[:, 1:].max() <= 0.5 * HEADROOM
    risk = values[0, 0]
    assert risk < before[0, 0] - 0.05

    def part(x: np.ndarray, which: int, rows: slice) -> np.ndarray:
        return evaluated(case, np.tile(x, (len(case.z), 1)))[which][0][rows]

    held = NonlinearConstraint(
        lambda x: part(x, 0, slice(1, None)), -np.inf, 0.0, jac=lambda x: part(x, 1, slice(1, None))
    )
    other = minimize(
        lambda x: part(x, 0, slice(0, 1))[0],
        z[moved],
        jac=lambda x: part(x, 1, slice(0, 1))[0],
        method="trust-constr",
        constraints=held,
        bounds=[(value - REACH, value + REACH) for value in z[moved]],
        options={"maxiter": 300, "gtol": 1e-6},
    )
    assert risk == pytest.approx(other.fun, abs=2e-3)


def test_a_correction_turns_what_was_said_into_what_was_measured() -> None:
    """Peaks from the RMS; where the spectra say nothing there is nothing to correct."""
    random = np.random.default_rng(0)
    fine, coarse = (Metrics(*random.uniform(1.0, 2.0, (len(Metrics._fields), 2, 3, 1, 3))) for _ in range(2))
    coarse = coarse._replace(
        peak_to_peak=np.full((2, 3, 1, 3), np.nan), effort=coarse.effort * (np.arange(3) > 0), chatter=2.0 * coarse.rms
    )
    found = correction(fine, coarse)
    for name in ("rms", "peak_to_peak", "peak_force", "peak_error"):
        np.testing.assert_allclose(getattr(found, name) * coarse.rms, getattr(fine, name), rtol=1e-12)
    np.testing.assert_allclose(2.0 * found.chatter * coarse.rms, fine.chatter, rtol=1e-12)
    np.testing.assert_array_equal(found.effort[..., 0], 1.0)


def test_searches_follow_the_best_and_none_that_lost_the_heart() -> None:
    z = np.arange(12.0).reshape(6, 2)
    none: Any = None
    measured = Measured(z, np.array([3.0, np.nan, 1.0, 2.0, np.nan, np.nan]), none)
    assert [k for k, _ in parents(measured, 4, 1, 0)] == [2, 3, 0, 2]
    assert [k for k, _ in parents(measured, 4, 2, 0)] == [2, 3, 2, 2]
    first, again, other = (parents(measured, 4, 2, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal([begin for _, begin in first], [begin for _, begin in again])
    assert not np.allclose([begin for _, begin in first], [begin for _, begin in other])
    assert parents(measured._replace(loss=np.full(6, np.nan)), 4, 1, 0) == []


@pytest.mark.slow
@in_float64
def test_it_improves_and_a_killed_one_continues_to_the_same_bits(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = case.spec, case.measuring, case.spectra, case.z
    whole = refine(*job)
    assert (np.diff(whole.incumbent[: whole.iteration]) <= 0.0).all()
    assert whole.feasible
    assert np.log(whole.best.min()) < case.measured.loss.min() - 0.1
    record = SearchState.record

    def killed(self: SearchState, *args: Any, **kwargs: Any) -> None:
        if self.iteration == 2:
            raise KeyboardInterrupt
        record(self, *args, **kwargs)

    monkeypatch.setattr(SearchState, "record", killed)
    with pytest.raises(KeyboardInterrupt):
        refine(*job, tmp_path)
    monkeypatch.setattr(SearchState, "record", record)
    resumed = refine(*job, tmp_path)
    for field in fields(SearchState):
        for a, b in zip(*(jax.tree.leaves(getattr(state, field.name)) for state in (whole, resumed)), strict=True):
            np.testing.assert_array_equal(a, b, err_msg=field.name)
