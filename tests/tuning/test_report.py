"""The report: complete, escaped, reachable offline, and with the numbers of the result."""

import re
import tomllib
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import METRICS
from jaxmpc.report.loops import Curves
from jaxmpc.stability import Margins
from jaxmpc.world.heart.motion import Motion
from tuning import Scenarios, TuneResult, TuneSpec, report
from tuning.proof.flyable import freeze_command
from tuning.proof.limits import Active, LimitStudy, active_margins
from tuning.proof.reached import STUDY, Row, rows, verdict
from tuning.proof.sensitivities import Sensitivities
from tuning.proof.split import Split
from tuning.reports.charts import heldout_charts
from tuning.reports.explained import Study, limits_text
from tuning.reports.figures import best_of_each_iteration
from tuning.reports.files import tuned_on, write
from tuning.reports.limit import limit_section
from tuning.reports.page import html_report
from tuning.reports.points import points
from tuning.search.run import Step
from tuning.search.state import SearchState

Job = Callable[..., dict[str, Any]]
NAME = '<b>"a & b"</b>'
SEEDS = (1000, 1001, 1002, 1007)


@pytest.fixture
def result(small: Job) -> TuneResult:
    """A made-up one: scenario 1001 was lost before, M_s is active, λ is a diagonal, before has another structure."""
    spec = TuneSpec.from_dict(
        small(
            baseline={"disturbance_order": 2, "Q_p": 1e-3},
            tune={
                "heldout_seeds": list(SEEDS),
                "validation_seeds": [500],
                "margin_points": 5,
                "free": {"lam": True, "Q_p": True, "Hp": True},
                "diagonals": ["lam"],
            },
            goals={"M_s": 2.0, "delay_margin_s": 1e-3, "ideal": False, "soft": {"rms": 0.1, "peak_to_peak_ratio": 1.0}},
        )
    )
    # No file may give such a name; should one come another way, the page must not believe it.
    msgspec.structs.force_setattr(spec.experiment, "name", NAME)
    random = np.random.default_rng(0)
    heldout = Metrics(*(random.uniform(0.02, 0.08, (2, len(SEEDS), 3, 3)) for _ in Metrics._fields))
    heldout.peak_error[0, 1, 2] = 3.0
    judged = len(spec.judged_at)
    M_s = np.stack([np.linspace(5.0, 3.0, judged), np.linspace(1.4, 1.98, judged)])
    one = np.ones((2, judged))
    found = Margins(M_s, 6.0 * one, 7.0 * one, 40.0 * one, 2e-3 * one, 0.9 * one, 0.0 * one)
    state = SearchState.new(spec.space.draw(2, 0), None, 3, (2, 2))
    for iteration in range(3):
        state.record(_values(0.9 - 0.1 * iteration, judged), exact=True, worth=0.0)
        state.iteration += 1
    problem: Any = SimpleNamespace(hard_goals=())
    steps = [Step("linear", problem, state)]
    margins = {"as run": found, "ideal": found}
    params = spec.space.exact(state.leader_z)
    return TuneResult(spec, params, True, margins, (None, None), steps, {1: 0.5, 2: 0.7}, heldout)


def _values(hard: float, judged: int) -> Any:
    cells = Metrics(*(np.full((2, 3, 1, 3), 0.05) for _ in Metrics._fields))
    numbers = {"score": np.array([hard, 1.0]), "worst": np.full(2, 0.05), "tissue": np.zeros(2, int), "cells": cells}
    return SimpleNamespace(**numbers, M_s=np.full((2, judged), 1.9), hard=np.full((2, 2), hard), soft=np.ones((2, 2)))


@pytest.fixture
def study() -> Study:
    frequency, time = np.geomspace(0.1, 500.0, 40), np.arange(50) * 1e-3
    loop = np.tile(10.0 / (1j * frequency), (3, 1))
    curve = Curves(frequency, loop, time, np.tile(1.0 - np.exp(-time / 0.01), (3, 1)))
    slopes = np.arange(18.0).reshape(2, 3, 3) / 10.0
    metrics, parameters = ("score", "M_s"), ("lam", "Q_p", "Hp")
    parts = (np.full((2, 3, 3), size) for size in (0.05, 0.03, 0.04, 0.01))
    return Study(
        (curve, curve),
        Sensitivities(metrics, parameters, np.ones((2, 3)), slopes),
        Split(*parts),
        LimitStudy([Active("M_s", 1900.0, 0.99, 0.5)], 0.2),
    )


def test_the_text_says_it_all(result: TuneResult) -> None:
    said = report(result)
    assert "all hard goals are met" in said
    assert re.search(r"hard: M_s ≤ 2 +5 +1.98 +yes +1900", said)
    assert re.search(r"held out +1000–1002, 1007", said)
    assert re.search(r"validation +500", said)
    assert "Lost before: 1001 (left out below); lost after: none" in said
    assert "M_s is active at 1900 N/m, 99.0 % of its limit" in said
    worst = 1e3 * result.heldout.rms[:, [0, 2, 3], 0, 0].max(axis=1)
    assert re.search(rf"375 +{worst[0]:.1f} → {worst[1]:.1f}", said)


def test_a_motion_that_no_seed_draws_is_not_called_held_out(result: TuneResult) -> None:
    said = "own motion is one, the same held out as in training, which saw its first 5 s"
    assert said not in report(result)
    one = msgspec.structs.replace(result.spec.experiment, name="one", motion=Motion(kind="none"))
    of_one = msgspec.structs.replace(result.spec, experiment=one)
    assert said in report(replace(result, spec=of_one))
    drawn = msgspec.structs.replace(of_one, scenarios=Scenarios(rhythms=("premature",)))
    assert said not in report(replace(result, spec=drawn))


def test_a_goal_that_held_in_training_alone_is_told(result: TuneResult, monkeypatch: pytest.MonkeyPatch) -> None:
    known, missed = rows(result), Row("chatter", True, 1.2, (0.8, 1.207), 1900.0)
    monkeypatch.setattr("tuning.proof.reached.rows", lambda _: [*known, missed])
    assert verdict(result) == "all hard goals are met in training; held out, missed: chatter ≤ 1.2 m/s²"


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


def test_the_best_of_a_look_holds_its_goals_if_any_does() -> None:
    state = SearchState.new(np.zeros((3, 2)), (), 4, (2, 1))
    state.iteration = 3
    state.score[:3] = [[0.5, 2.0, 3.0], [0.9, np.nan, 0.8], [np.nan, np.nan, 1.0]]
    state.hard[:3] = 1.0
    state.hard[0, 0, 1], state.hard[2] = 1.1, 2.0
    np.testing.assert_array_equal(best_of_each_iteration(state), [1, 2, 2])


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


def test_the_command_in_the_file_freezes_what_was_tuned_on_what_it_was_tuned_on(small: Job) -> None:
    arm = TuneSpec.from_dict(
        small(
            experiment={"published": "table-1-wam", "arm": {"compensation": 0.7}, "stiffness": [300.0, 3000.0]},
            goals={"ideal": False, "M_s": 1.9, "gain_margin_db": 6.0205999, "delay_margin_s": 1.5e-3},
        )
    )
    words = freeze_command(arm, "experiment.toml").split()
    assert words[:5] == ["jaxmpc", "freeze", "params.toml", "--experiment", "experiment.toml"]
    promised = ["--max-ms", "1.9", "--min-delay-ms", "1.5", "--min-gain-db", "6.0205999"]
    assert words[5:-2] == promised, "no digit less: it could be refused for the last"
    assert Experiment.from_dict(tuned_on(arm.experiment)) == arm.experiment
    ideal = TuneSpec.from_dict(small(goals={"ideal": True, "gain_margin_db": 6.0}))
    assert freeze_command(ideal, "table-1").split()[5:-2] == ["--ideal", "--max-ms", "2", "--min-gain-db", "6"]


def test_a_recording_that_was_tuned_on_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.savetxt("heart.csv", np.zeros((2000, 3)), delimiter=",")
    experiment = Experiment(motion=Motion(kind="recording", file="heart.csv"))
    assert tuned_on(experiment)["motion"]["file"] == str(tmp_path / "heart.csv")


def done(found: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(found)
    return future


def test_files_are_whole_and_the_page_needs_nothing_else(result: TuneResult, study: Study, tmp_path: Path) -> None:
    write(result, done(study), tmp_path, done(None))
    texts = {"params.toml", "experiment.toml", "history.npz", "report.txt", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == texts | {"before_after.png"}
    assert Params.from_toml(tmp_path / "params.toml").lam.shape == (16,)
    assert (tmp_path / "before_after.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == html_report(result, study)


def test_what_was_found_is_kept_where_explaining_it_fails(result: TuneResult, tmp_path: Path) -> None:
    failed: Future[Study] = Future()
    failed.set_exception(MemoryError())
    with pytest.raises(MemoryError):
        write(result, failed, tmp_path, done(None))
    assert (tmp_path / "params.toml").exists()
    assert (tmp_path / "report.txt").exists()


def test_the_page_says_it_all(result: TuneResult, study: Study) -> None:
    page = html_report(result, study)
    assert re.findall(r"<h2>([^<]*)</h2>", page) == [
        "Residual on held-out scenarios",
        "Goals",
        "Parameters",
        "Scenarios",
        "Robustness",
        "What limits it",
        "Causes of the residual",
        "Sensitivity to the parameters",
        "The way there: linear",
    ]
    assert NAME not in page
    assert "&lt;b&gt;&quot;a &amp; b&quot;&lt;/b&gt;" in page
    assert len(page) < 2e6
    # The tables name every scenario, the lost one too.
    assert page.count("1001, 375 N/m") == len(METRICS)
    # Six of held-out residuals, five of every tissue, an axis each of the causes, two metrics, the way there.
    assert page.count('class="chart"') == 6 + 5 * 3 + 3 + 2 + (2 + 2 + 3)


def test_every_point_of_the_search_is_a_row(result: TuneResult) -> None:
    rows = points(result)
    assert rows is not None
    state = result.state
    assert len(rows) == state.iteration * state.path.shape[1]
    by_name = {each.name: each for each in rows.measures}
    assert by_name["M_s/limit"].limit == 1.0
    np.testing.assert_array_equal(by_name["score"].values, state.score[: state.iteration].ravel())
    place, detail = next(iter(rows.details.items()))
    start = int(rows.names[place].rpartition(" ")[2])
    best = result.spec.space.exact(state.best_z[start])
    assert tomllib.loads(detail.toml)["params"] == best.to_dict()
    assert freeze_command(result.spec, "experiment.toml") in detail.toml


def test_scenarios_that_were_lost_before_do_not_count(result: TuneResult) -> None:
    dots = heldout_charts(result)[0].series[1]
    assert len(np.asarray(dots.y)) == 3 * 3
    np.testing.assert_allclose(np.sort(np.asarray(dots.y)[:3]), np.sort(1e3 * result.heldout.rms[0, [0, 2, 3], 0, 0]))


@pytest.mark.slow
def test_nothing_held_and_nothing_met(result: TuneResult, study: Study) -> None:
    lost = Metrics(*(np.where(np.arange(2)[:, None, None, None] == 0, np.nan, field) for field in result.heldout))
    worse = result.margins["as run"]._replace(
        M_s=np.array([[np.inf], [2.5]]) * np.ones_like(result.margins["as run"].M_s)
    )
    failed = replace(result, heldout=lost, feasible=False, margins={"as run": worse, "ideal": worse})
    held = LimitStudy([Active("M_s", 375.0, 1.25, np.nan)], np.nan)
    parts = Split(*(np.full((2, 3, 3), np.nan) for _ in Split._fields))
    page = html_report(failed, study._replace(limits=held, split=parts))
    said = report(failed)
    assert "M_s ≤ 2 is missed by 0.5" in said
    assert "M_s is missed at 1900 N/m, 125.0 % of its limit" in said
    assert "Lost before: 1000, 1001, 1002, 1007 (all of them, so none is left out)" in said
    assert "unstable → " in page
    assert "relaxed" not in page


def test_only_peaks_of_a_margin_are_active(result: TuneResult) -> None:
    M_s = np.array([[2.5] * 8, [1.97, 1.99, 1.97, 1.5, 1.0, 1.0, 1.95, 1.96]])[:, : len(result.spec.judged_at)]
    judged = result.margins["as run"]._replace(M_s=M_s)
    found = active_margins(replace(result, margins={"as run": judged, "ideal": judged}))
    assert (found[0].goal, found[0].normalised) == ("M_s", pytest.approx(0.995))
    assert found[0].stiffness == result.spec.judged_at[1]


def test_what_limits_it_in_words(result: TuneResult, study: Study) -> None:
    active, slope, parts = limits_text(result, study)
    assert "M_s is active at 1900 N/m: 99.0 % of its limit" in active
    assert f"fall by some {100 * (1 - 1.1**-0.5):.1f} %" in active
    assert "all but 20 %" in slope
    assert "friction 40.0 mN (64 % of its power), noise 10.0 mN (4 % of its power)" in parts


@pytest.mark.oracle
def test_the_limit_of_the_same_goals_stands_beside_it(result: TuneResult) -> None:
    section = limit_section(replace(result, params=Params.published("cautious")))
    rows = [cell for table in section.tables for cell in table.rows]
    assert len(rows) == 3 * len(result.spec.experiment.stiffness)
    for _, *numbers, ratio in rows:
        assert float(ratio) == pytest.approx(float(numbers[-1]) / float(numbers[0]), rel=0.01)
        assert float(ratio) > 1.0
    assert "× the limit" in section.sentences[-1]
