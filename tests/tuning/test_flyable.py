"""A result that freezing would refuse is none: implied goals, and the best of the starts that is accepted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tuning.proof.result
from jaxmpc.files.errors import InputError
from jaxmpc.metrics import Metrics
from jaxmpc.synthesis.params import Params
from tuning import TuneSpec
from tuning.proof.flyable import floor_of, refusal
from tuning.proof.found import FoundController
from tuning.proof.result import _ranked, assess
from tuning.search.run import SearchHistory, Step
from tuning.search.state import SearchState

Job = Callable[..., dict[str, Any]]
UNLIMITED = {"joint_torque_limit": [0.0] * 4, "torque_step_limit": [0.0] * 4}


def on_arm(small: Job, arm: dict[str, Any], **goals: Any) -> TuneSpec:
    goals = {"ideal": False, **goals}
    return TuneSpec.from_dict(small(experiment={"published": "table-1-wam", "arm": arm}, goals=goals))


def test_ideal_damping_is_refused_where_freezing_would_refuse_it(small: Job) -> None:
    with pytest.raises(InputError, match=r"goals\.ideal = True: must be false on an arm with a robot's limits"):
        on_arm(small, {}, ideal=True)
    assert on_arm(small, UNLIMITED, ideal=True).ideal


def test_limits_of_the_arm_imply_goals_where_none_are_given(small: Job) -> None:
    spec = on_arm(small, {}, M_s=1.9)
    assert spec.goals == {"M_s": 1.9}
    implied = {"clamped": 1e-3, "joint_torque": 50.0, "torque_step": 10.0, "chatter": pytest.approx(1.2)}
    assert spec.held == {"M_s": 1.9, **implied}
    assert set(spec.hard_goals) == set(spec.implied) == set(implied)
    assert set(on_arm(small, {}, M_s=1.9, chatter=0.9, clamped=1e-3).implied) == {"joint_torque", "torque_step"}
    assert on_arm(small, {"torque_step_limit": [5.0] * 4}).held["chatter"] == pytest.approx(0.6)
    assert set(on_arm(small, {"torque_step_limit": [0.0] * 4}).implied) == {"clamped", "joint_torque"}
    assert on_arm(small, UNLIMITED, M_s=1.9).held == {"M_s": 1.9}
    assert TuneSpec.from_dict(small()).implied == {}


def test_the_search_holds_the_peak_that_freezing_promises_whatever_the_goals_are(small: Job) -> None:
    spec = on_arm(small, {}, gain_margin_db=2.0)
    assert spec.margin_goals == {"M_s": 2.0, "gain_margin_db": 2.0} == floor_of(spec)
    assert on_arm(small, {}, gain_margin_db=2.0, M_s=3.0).margin_goals["M_s"] == 3.0
    study = on_arm(small, UNLIMITED, gain_margin_db=2.0)
    assert set(study.margin_goals) == {"gain_margin_db"}, "nobody promises it of a study"


def test_an_implied_goal_is_part_of_the_job(small: Job) -> None:
    implied, given = on_arm(small, {}), on_arm(small, {}, M_s=2.0, chatter=0.12 * 10.0, clamped=1e-3)
    assert implied.digest == given.digest
    assert implied.digest != on_arm(small, {}, M_s=2.0, chatter=2.0, clamped=1e-3).digest


def test_freezing_is_asked_with_the_margins_of_the_job(small: Job) -> None:
    spec = on_arm(small, {}, phase_margin_deg=30.0)
    assert floor_of(spec) == {"M_s": 2.0, "phase_margin_deg": 30.0}
    assert floor_of(on_arm(small, UNLIMITED, M_s=3.0, ideal=True)) == {"M_s": 2.0}, "a frozen arm is judged as it runs"
    assert "M_s at 375 N/m = 4.389" in refusal(spec, Params.published("text"))
    assert refusal(on_arm(small, UNLIMITED), Params.published("text")) == "", "a study is not for a robot"


@pytest.mark.parametrize(
    ("efforts", "chosen"),
    [
        ((0.9, 0.8, 0.7), 2),
        ((0.7, 0.8, 0.9), 2),
        ((0.9, 0.8, 1.001), 1),
        ((np.nan, 1.2, 1.1), 2),
        ((1.3, 0.9, np.nan), 1),
    ],
    ids=["all hold", "the best by less", "the best misses", "closest", "one alone"],
)
def test_who_misses_a_hard_goal_in_validation_comes_after_who_holds_all(
    small: Job, monkeypatch: pytest.MonkeyPatch, efforts: tuple[float, ...], chosen: int
) -> None:
    """The third leaves the least residual, then the second."""
    tune = {"starts": 3, "free": {"K2": True}, "validation_seeds": [500]}
    spec = TuneSpec.from_dict(small(tune=tune, goals={"M_s": 50.0, "effort": 1.0, "ideal": False}))
    state = SearchState.new(spec.space.draw(3, 0), (), 1, (2, 1))
    state.best_z, state.best = state.z, np.array([0.9, 0.8, 0.7])
    starts = [spec.space.exact(z) for z in state.z]

    def versus(_: Any, proven: list[Params], *__: Any) -> Any:
        found = []
        for one in proven:
            which = [float(one.K2) == float(each.K2) for each in starts].index(True)
            runs = Metrics(*(np.full((1, 3, 3), 0.3 - 0.1 * which) for _ in Metrics._fields))
            found.append(runs._replace(effort=np.full((1, 3, 3), efforts[which])))
        return found[0], found

    monkeypatch.setattr(tuning.proof.result, "versus", versus)
    assert float(_ranked(spec, state, False)[0].K2) == float(starts[chosen].K2)


@pytest.mark.parametrize(
    ("refused", "missed", "chosen"),
    [
        ((), (), 1),
        ((1,), (), 2),
        ((1, 2, 0), (), 1),
        ((), (1,), 2),
        ((2,), (1,), 0),
        ((2, 0), (1,), 1),
        ((), (0, 1, 2), 1),
    ],
)
def test_the_best_start_that_may_fly_is_the_result(
    small: Job, monkeypatch: pytest.MonkeyPatch, refused: tuple[int, ...], missed: tuple[int, ...], chosen: int
) -> None:
    """The margins of a family are judged at fewer rates of the heart by the search than by the proof."""
    spec = TuneSpec.from_dict(small(tune={"starts": 3, "free": {"K2": True}}, goals={"M_s": 50.0}))
    state = SearchState.new(spec.space.draw(3, 0), (), 1, (1, 1))
    state.best_z, state.best = state.z, np.array([0.9, 0.5, 0.7])
    state.path[0], state.hard[0], state.iteration = state.z, 0.9, 1
    starts = [spec.space.exact(z) for z in state.z]
    runs: Any = np.zeros((2, 3, 3))
    monkeypatch.setattr(
        tuning.proof.result, "versus", lambda _, proven, *__: (runs, [runs + float(one.K2) for one in proven])
    )
    monkeypatch.setattr(
        tuning.proof.result, "refusal", lambda _, params: "its torque" * (params in [starts[i] for i in refused])
    )
    monkeypatch.setattr(
        FoundController, "proven", property(lambda found: found.params not in [starts[i] for i in missed])
    )
    problem: Any = None
    result = assess(SearchHistory(spec, [Step("linear", problem, state)], {}))
    assert float(result.params.K2) == float(starts[chosen].K2)
    after: Any = result.heldout
    assert (after[1] == float(result.params.K2)).all(), "what is told is of what was chosen"
    assert result.met == (chosen not in (*refused, *missed))
    assert result.refused == ("its torque" if chosen in refused else "")
