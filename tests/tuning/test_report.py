"""The report: complete, escaped, reachable offline, and with the numbers of the result."""

import re
import tomllib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import METRICS
from jaxmpc.world.heart.motion import Motion
from tuning import Scenarios, TuneResult, report
from tuning.proof.flyable import freeze_command
from tuning.proof.limits import Active, LimitStudy, active_margins
from tuning.proof.split import Split
from tuning.reports.charts import heldout_charts
from tuning.reports.explained import Study, limits_text
from tuning.reports.figures import best_of_each_iteration
from tuning.reports.limit import limit_section
from tuning.reports.page import html_report
from tuning.reports.points import points
from tuning.search.state import SearchState


def test_the_text_says_it_all(result: TuneResult) -> None:
    said = report(result)
    assert "all hard goals are met" in said
    assert re.search(r"hard: M_s ≤ 2 +5 +1.98 +yes +1900", said)
    assert re.search(r"held out +1000–1002, 1007", said)
    assert re.search(r"validation +500", said)
    assert "Lost before: 1001 (left out below); lost after: none" in said
    assert f"Worst margins of {len(result.spec.judged_at)} tissues, 375–1900 N/m, after (before)" in said
    assert "M_s is active at 1900 N/m, 99.0 % of its limit" in said
    worst = 1e3 * result.heldout.rms[:, [0, 2, 3], 0, 0].max(axis=1)
    assert re.search(rf"375 +{worst[0]:.1f} → {worst[1]:.1f}", said)


def test_what_only_joints_have_is_left_out_of_a_report_of_the_linear_loop(result: TuneResult) -> None:
    names = [metric.heading for metric in METRICS.values() if metric.arm_only]
    on_arm = Experiment.published("table-1-wam")
    for heading in names:
        assert heading not in report(result)
        assert heading in report(replace(result, spec=msgspec.structs.replace(result.spec, experiment=on_arm)))


def test_a_motion_that_no_seed_draws_is_not_called_held_out(result: TuneResult) -> None:
    said = "own motion is one, the same held out as in training, which saw its first 5 s"
    assert said not in report(result)
    one = msgspec.structs.replace(result.spec.experiment, name="one", motion=Motion(kind="none"))
    of_one = msgspec.structs.replace(result.spec, experiment=one)
    assert said in report(replace(result, spec=of_one))
    drawn = msgspec.structs.replace(of_one, scenarios=Scenarios(rhythms=("premature",)))
    assert said not in report(replace(result, spec=drawn))


def test_the_best_of_a_look_holds_its_goals_if_any_does() -> None:
    state = SearchState.new(np.zeros((3, 2)), (), 4, (2, 1))
    state.iteration = 3
    state.score[:3] = [[0.5, 2.0, 3.0], [0.9, np.nan, 0.8], [np.nan, np.nan, 1.0]]
    state.hard[:3] = 1.0
    state.hard[0, 0, 1], state.hard[2] = 1.1, 2.0
    np.testing.assert_array_equal(best_of_each_iteration(state), [1, 2, 2])


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
    assert result.spec.experiment.name not in page
    assert "&lt;b&gt;&quot;a &amp; b&quot;&lt;/b&gt;" in page
    assert len(page) < 2e6
    # The tables name every scenario, the lost one too.
    assert page.count("1001, 375 N/m") == sum(not metric.arm_only for metric in METRICS.values())
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
    free, _ = limits_text(result, study._replace(limits=LimitStudy([], 1.0)))
    assert free.startswith("No hard goal is active"), "so none balances anything"


def test_a_parameter_that_rests_at_its_bound_is_told(result: TuneResult, study: Study) -> None:
    """The search is squashed into the bounds: at one it has no slope, however much there is to gain beyond."""
    axes = {axis.name: axis for axis in result.spec.space.axes}
    resting = replace(result, params=replace(result.params, Q_p=0.99 * axes["Q_p"].high, Hp=axes["Hp"].high))
    said = [line for line in limits_text(resting, study) if "rests at its bound" in line]
    assert [line.partition(":")[0] for line in said] == [
        f"Q_p rests at its bound of {axes['Q_p'].high:g} (m/s²)²/N²",
        f"Hp rests at its bound of {axes['Hp'].high:g} samples",
    ]
    assert f"Q_p rests at its bound of {axes['Q_p'].high:g} (m/s²)²/N².\n" in report(resting), "in the text, too"
    assert "rests at" not in report(result)


@pytest.mark.oracle
def test_the_limit_of_the_same_goals_stands_beside_it(result: TuneResult) -> None:
    section = limit_section(replace(result, params=Params.published("cautious")))
    rows = [cell for table in section.tables for cell in table.rows]
    assert len(rows) == 3 * len(result.spec.experiment.stiffness)
    for _, *numbers, ratio in rows:
        assert float(ratio) == pytest.approx(float(numbers[-1]) / float(numbers[0]), rel=0.01)
        assert float(ratio) > 1.0
    assert "× the limit" in section.sentences[-1]
