"""The verdict on a result: which goals are met, on what, beside whom, and by whose word."""

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc.metrics import Metrics
from tuning import TuneResult, TuneSpec, report
from tuning.objective.problem import problem_of, training
from tuning.proof.reached import STUDY, Row, rows, verdict
from tuning.search.run import Step
from tuning.search.state import SearchState

Job = Callable[..., dict[str, Any]]


def test_a_goal_that_held_in_training_alone_is_told(result: TuneResult, monkeypatch: pytest.MonkeyPatch) -> None:
    known, missed = rows(result), Row("chatter", True, 1.2, (0.8, 1.207), 1900.0)
    monkeypatch.setattr("tuning.proof.reached.rows", lambda _: [*known, missed])
    assert verdict(result) == "all hard goals are met in training; held out, missed: chatter ≤ 1.2 m/s²"


def test_a_goal_of_the_runs_is_missed_where_it_stands_worst_not_where_the_soft_goals_do(
    small: Job, result: TuneResult
) -> None:
    """Effort on the middle tissue; the residual on the first."""
    goals = {"M_s": 2.0, "effort": 1.0, "ideal": False, "soft": {"rms": 0.1}}
    spec = TuneSpec.from_dict(small(tune={"margin_points": 5}, goals=goals))
    problem = problem_of(spec, training(spec, (0,)))
    cells = Metrics(*(np.array([0.3, 0.2, 0.1])[None, :, None, None] * np.ones((2, 3, 1, 3)) for _ in Metrics._fields))
    cells.effort[:, 1] = 1.5
    state = SearchState.new(spec.space.draw(2, 0), None, 1, (2, 1))
    numbers = {"score": np.ones(2), "worst": np.full(2, 0.3), "tissue": np.zeros(2, int), "cells": cells}
    hard = np.array([[0.9, 1.5], [0.9, 1.6]])
    seen: Any = SimpleNamespace(**numbers, M_s=np.ones((2, 3)), hard=hard, soft=np.ones((2, 1)))
    state.record(seen, exact=True, worth=0.0, hard_at=problem.hard_at(cells))
    state.iteration += 1
    missed = replace(result, spec=spec, feasible=state.feasible, steps=[Step("linear", problem, state)])
    found = "no point meets every goal: effort ≤ 1 m/s² is missed by 0.5 m/s² in training, worst on 810 N/m"
    assert missed.unmet() == f"{found} by the point that came closest"


def test_an_overshoot_is_missed_by_the_linear_loop_and_not_in_training(small: Job, result: TuneResult) -> None:
    goals = {"M_s": 2.0, "overshoot": 0.5, "ideal": False, "soft": {"rms": 0.1}}
    spec = TuneSpec.from_dict(small(tune={"margin_points": 5}, goals=goals))
    problem = problem_of(spec, training(spec, (0,)))
    state = SearchState.new(spec.space.draw(1, 0), None, 1, (2, 1))
    cells = Metrics(*(np.full((1, 3, 1, 3), 0.1) for _ in Metrics._fields))
    numbers = {"score": np.ones(1), "worst": np.full(1, 0.1), "tissue": np.zeros(1, int), "cells": cells}
    seen: Any = SimpleNamespace(**numbers, M_s=np.ones((1, 3)), hard=np.array([[0.9, 1.1]]), soft=np.ones((1, 1)))
    state.record(seen, exact=True, worth=0.0, hard_at=problem.hard_at(cells))
    state.iteration += 1
    missed = replace(result, spec=spec, feasible=False, steps=[Step("linear", problem, state)])
    found = "no point meets every goal: overshoot ≤ 0.5 is missed by 0.05 by the point that came closest"
    assert missed.unmet() == found


def test_what_freezing_refuses_is_not_met(result: TuneResult) -> None:
    refused = replace(result, refused="golden_torque of J2 = 117 N m")
    assert not refused.met
    assert report(refused).startswith("it may not fly: freeze refuses golden_torque of J2 = 117 N m\n")


def test_a_goal_that_the_proof_judges_missed_is_not_met(result: TuneResult) -> None:
    """The search judges a family at fewer rates of the heart; of a study nobody asks freezing."""
    found = result.margins["as run"]
    seen = replace(result, margins={"as run": found._replace(M_s=found.M_s + 0.03), "ideal": found})
    assert verdict(seen).startswith("no point meets every goal: M_s ≤ 2 is missed by 0.01 at 1900 N/m")
    assert not seen.met


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("tissue", range(3))
def test_who_leaves_2_n_on_one_axis_of_one_tissue_has_not_held(result: TuneResult, tissue: int, axis: int) -> None:
    assert result.held[1].all()
    result.heldout.peak_error[1, 2, tissue, axis] = 2.0
    assert result.held[1].tolist() == [True, True, False, True]


def test_a_study_without_limits_says_so_first(result: TuneResult) -> None:
    arm = msgspec.structs.replace(result.spec.experiment, name="study", physics="wam")
    study = replace(result, spec=msgspec.structs.replace(result.spec, experiment=arm.without_limits()))
    assert verdict(study) == f"all hard goals are met; {STUDY}"
    limited = replace(result, spec=msgspec.structs.replace(result.spec, experiment=arm))
    assert (
        verdict(limited) == "all hard goals are met in training; held out, missed: clamped ≤ 0.001; freeze accepts it"
    )
    implied = [row for row in rows(limited) if row.kind == "implied"]
    assert [row.name for row in implied] == ["chatter", "clamped", "joint_torque", "torque_step"]


def test_ratios_are_those_of_the_scenarios_that_were_held_before(result: TuneResult) -> None:
    M_s, delay, rms, ratio = rows(result)
    counted = [0, 2, 3]
    assert (M_s.reached, M_s.met, M_s.at) == ((5.0, 1.98), True, 1900.0)
    assert (delay.reached, delay.met, delay.hard) == ((2e-3, 2e-3), True, True)
    assert rms.reached == pytest.approx([result.heldout.rms[which].max() for which in (0, 1)])
    before, after = result.heldout.peak_to_peak[:, counted]
    assert ratio.reached == pytest.approx([1.0, (after / before).max()])
    assert not ratio.met
    assert not ratio.hard


def test_who_is_lost_where_the_one_before_was_lost_has_not_met_every_goal(result: TuneResult) -> None:
    for field in result.heldout:
        field[1, 1] = np.nan
    _, _, rms, ratio = rows(result)
    assert np.isnan(rms.reached[1])
    assert not rms.met
    assert np.isfinite(ratio.reached).all()
    assert verdict(result) == "all hard goals are met in training; held out, missed: |e| < 2 N in scenario 1001"


@pytest.mark.parametrize("peak", [np.nan, 3.0])
def test_a_ratio_beside_a_baseline_that_was_lost_says_so(result: TuneResult, peak: float) -> None:
    """On 1900 N/m in every scenario: then none is left out, and who lasts has met the ratio there."""
    result.heldout.peak_to_peak[1] = 0.5 * result.heldout.peak_to_peak[0]
    result.heldout.peak_error[0, :, 2] = peak
    result.heldout.peak_to_peak[0, :, 2] = 100.0 * peak
    *others, ratio = rows(result)
    assert ratio.met
    assert ratio.said == "yes (baseline lost on 1900 N/m)"
    assert [row.said for row in others] == ["yes"] * len(others)
    assert re.search(r"soft: peak_to_peak_ratio ≤ 1 .* yes \(baseline lost on 1900 N/m\)", report(result))
    assert verdict(result) == (
        "all hard goals are met (baseline lost on 1900 N/m: whatever lasts has met ratios there)"
    )


def test_a_search_whose_runs_were_all_lost_has_met_nothing(result: TuneResult) -> None:
    state = result.state
    state.best[:], state.best_z[:], state.score[:] = np.inf, np.nan, np.nan
    lost = replace(result, feasible=state.feasible)
    assert not lost.met
    assert verdict(lost) == lost.unmet()
    assert lost.unmet().startswith("no point was found that has a score")
