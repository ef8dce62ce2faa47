"""Which rows float32 cannot decide: with these in float64, status and best rows are those of the whole sweep in it."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.loop.linear import HIGHEST_ERROR
from jaxmpc.quantities import METRICS
from jaxmpc.status import Status
from sweeps.decided import plan_in_float64, with_decided
from sweeps.goal import SweepGoal
from sweeps.met import scored_time
from sweeps.plan import Plan, make_plan
from sweeps.result import Result
from sweeps.show.best_rows import chance
from sweeps.spec import SweepSpec
from sweeps.undecided import IN_FLOAT64, TOP, amplification, undecided
from tests.sweeps.drawn_rows import DATA, ROWS, drawn_rows

GOALS = (
    SweepGoal("rms", {"M_s": 5.0}),
    SweepGoal("true_rms", {"M_s": 3.0, "chatter": 0.5}),
    SweepGoal("peak_error", {}),
    SweepGoal("M_s", {"rms": 0.05}),
)


@pytest.fixture(scope="module")
def single() -> Result:
    """Every row in float32."""
    return drawn_rows("float32")


def on(goal: SweepGoal, result: Result) -> Result:
    return replace(result, plan=replace(result.plan, goal=goal))


def completed(result: Result, exact: Result) -> Result:
    """A float32 result in which what is undecided is taken from the sweep in float64."""
    again = plan_in_float64(result.plan, result.columns)
    if again is None:
        return result
    columns, decided = with_decided(result.columns, again, exact.take(again.rows).columns)
    return replace(result, columns=columns, decided=decided)


def assert_decided(found: Result, exact: Result) -> None:
    np.testing.assert_array_equal(found["status"], exact["status"])
    np.testing.assert_array_equal(found.feasible, exact.feasible)
    assert found.best(TOP)["row"].tolist() == exact.best(TOP)["row"].tolist()
    assert len(found.undecided()) == 0


@pytest.mark.oracle
def test_float32_is_as_near_as_it_is_said_to_be(single: Result, exact: Result) -> None:
    np.testing.assert_array_equal(single["status"], exact["status"])
    ok = exact.ok
    assert 200 < ok.sum() < ROWS
    amplified = amplification(exact.plan, exact.columns)[ok]
    for name, metric in METRICS.items():
        one, other = single.worst(name)[ok], exact.worst(name)[ok]
        measured = np.isfinite(other)
        assert measured.all() == (name != "swing")
        allowed = metric.float32_error * amplified * np.abs(other)
        assert (np.abs(one[measured] - other[measured]) <= allowed[measured]).all(), name
    for name in ("M_s", "gain_margin_db", "spectral_radius"):
        np.testing.assert_allclose(single[name], exact[name], rtol=1e-9, err_msg=name)


@pytest.mark.oracle
@pytest.mark.parametrize("goal", GOALS, ids=lambda goal: goal.text)
def test_status_and_best_rows_are_those_of_float64(goal: SweepGoal, single: Result, exact: Result) -> None:
    found = completed(on(goal, single), exact)
    assert_decided(found, on(goal, exact))
    assert found[IN_FLOAT64].sum() < ROWS / 2


def shaken(exact: Result, plan: Plan, seed: int) -> Result:
    """A sweep in float32 whose errors are as large as they are said to become, on each row by chance."""
    random = np.random.default_rng(seed)
    columns = dict(exact.columns) | {IN_FLOAT64: np.zeros(ROWS, bool)}
    amplified = amplification(plan, columns)
    for name, metric in METRICS.items():
        error = 0.95 * metric.float32_error * amplified * random.choice([-1.0, 1.0], ROWS)
        columns[name] = (columns[name] / np.maximum(1.0 + error, 1e-3)[:, None, None]).astype(np.float32)
    return Result(plan, columns)


def test_errors_as_large_as_they_are_said_to_become_do_no_harm(drawn: SweepSpec, exact: Result) -> None:
    wrong = 0
    for seed, goal in product(range(5), GOALS):
        before = shaken(exact, replace(make_plan(drawn), goal=goal), seed)
        wrong += int(before.best(1)["row"][0] != on(goal, exact).best(1)["row"][0])
        assert_decided(completed(before, exact), on(goal, exact))
    # Float32 alone takes another row for the best one.
    assert wrong > 0


def test_the_most_important_run_where_they_are_too_many(drawn: SweepSpec, single: Result, exact: Result) -> None:
    goal = SweepGoal("peak_error", {}, decide=3)
    result = on(goal, single)
    places = result.undecided()
    assert len(places) > 3
    again = plan_in_float64(result.plan, result.columns)
    assert again is not None
    assert again.rows.tolist() == sorted(result["row"][places[:3]].tolist())
    told = chance(completed(result, exact))
    assert [line.split(" rows")[0] for line in told] == ["3", str(len(completed(result, exact).undecided()))]
    for nothing in (on(replace_decide(goal, 0), single), on(goal, exact)):
        assert plan_in_float64(nothing.plan, nothing.columns) is None


def replace_decide(goal: SweepGoal, decide: int) -> SweepGoal:
    return SweepGoal(goal.best, goal.constraints, decide)


def made_up(columns: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Rows of which every number is given, on one tissue."""
    rows = len(columns["rms"])
    full = {name: np.zeros((rows, 1, 3)) for name in METRICS}
    for name, values in columns.items():
        full[name] = np.reshape(values, (rows, 1, 1)) * np.ones(3) if name in METRICS else np.reshape(values, (rows, 1))
    return {**full, "row": np.arange(rows), IN_FLOAT64: np.zeros(rows, bool)}


def test_of_no_rows_none_is_undecided(single: Result) -> None:
    """As where every row was set aside."""
    nothing = single.take(slice(0))
    assert len(nothing.undecided()) == 0
    assert chance(nothing) == []


def test_what_counts_as_undecided(drawn: SweepSpec) -> None:
    plan = replace(make_plan(drawn), goal=SweepGoal("rms", {"M_s": 2.0}))
    limit = plan.canonical["experiment"]["force_limit"]
    OK, FORCE, UNSTABLE, DIVERGED = Status.OK, Status.FORCE_LIMIT, Status.UNSTABLE, Status.DIVERGED
    table = [
        # rms, M_s, status, peak force, clamped, place in the order
        (0.0200, 1.5, OK, 5.0, 0.0, 0),  # two that float32 cannot tell apart
        (0.0201, 1.5, OK, 5.0, 0.0, 1),
        (0.0300, 1.5, OK, 5.0, 0.0, None),  # alone
        (0.0199, 2.1, OK, 5.0, 0.0, None),  # beyond a margin, which is certain
        (0.0400, 1.5, OK, 0.99 * limit, 0.0, 2),  # near the limit of the force
        (0.0500, 1.5, FORCE, 1.01 * limit, 0.0, 3),
        (0.0600, 1.5, FORCE, 2.00 * limit, 0.0, None),  # far from it
        (0.0100, 1.5, OK, 5.0, 0.01, 4),  # a torque limit acts
        (np.nan, 1.5, DIVERGED, np.nan, np.nan, 6),
        (0.0150, 3.0, FORCE, 900.0, 0.5, 5),
        (np.nan, np.inf, UNSTABLE, np.nan, np.nan, None),
    ]
    rms, M_s, status, peak_force, clamped, order = zip(*table, strict=True)
    given = {"rms": rms, "M_s": M_s, "status": status, "peak_force": peak_force, "clamped": clamped}
    columns = made_up(given)
    found = undecided(plan, columns).tolist()
    wanted = sorted((place, row) for row, place in enumerate(order) if place is not None)
    assert found[:4] == [row for _, row in wanted][:4]
    assert set(found) == {row for _, row in wanted}
    assert found[4] == 7
    columns[IN_FLOAT64][:] = True
    assert undecided(plan, columns).tolist() == []


@pytest.mark.parametrize("name", ["peak_force", "peak_error"])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, 1), (1, 1, 1), (1, 0.9, 0.8), (0.2, 1, 1)])
@pytest.mark.parametrize(("share", "near"), [(0.995, False), (1.005, True)])
def test_a_force_is_near_its_limit_in_any_direction(
    drawn: SweepSpec, name: str, direction: tuple[float, ...], share: float, near: bool
) -> None:
    """From where float32's error reaches it, along one axis or all, where no component is over 1/√3 of the length."""
    plan = make_plan(drawn)
    limit = {"peak_force": plan.canonical["experiment"]["force_limit"], "peak_error": HIGHEST_ERROR}[name]
    columns = made_up({"rms": [0.02, 0.03], "M_s": [1.5, 1.5], "peak_force": [5.0, 5.0]})
    columns |= {"status": np.zeros((2, 1), np.int8), name: np.full((2, 1, 3), 0.1)}
    length = share * limit / (1.0 + METRICS[name].float32_error)
    columns[name][1, 0] = length * np.array(direction) / np.linalg.norm(direction)
    assert undecided(plan, columns).tolist() == [1] * near


@pytest.mark.parametrize("reduction", [20.0, np.inf])
def test_rows_that_are_infinitely_good_are_decided(drawn: SweepSpec, reduction: float) -> None:
    plan = replace(make_plan(drawn), goal=SweepGoal("gain_reduction_db", {"chatter": 1.0}))
    columns = made_up({"rms": [0.02] * 3, "peak_force": [5.0] * 3, "chatter": [1.001, 0.999, 0.5], "M_s": [1.5] * 3})
    columns |= {"status": np.zeros((3, 1), np.int8), "gain_reduction_db": np.full((3, 1), reduction)}
    assert sorted(undecided(plan, columns).tolist()) == [0, 1]
    columns["gain_reduction_db"][:2] = -np.inf  # as of a loop that is lost
    assert undecided(plan, columns).tolist() == []


RAMPS: Any = (
    {"kind": "ramp", "to": -5.0, "rate": 10.0},
    {"kind": "hold", "duration": 1.0},
    {"kind": "ramp", "to": -2.0, "rate": 8.0},
)


@pytest.mark.parametrize(
    ("base", "axes"),
    [
        (-5.0, {"settle": [0.2, 0.3], "duration": [2.0, 1.5]}),
        (RAMPS, {"settle": {"linear": [0.5, 1.5], "points": 3, "relative": True}, "sampling_time": [0.002, 0.001]}),
        (RAMPS, {"reference.z": [-5.0, -2.0], "duration": [2.0, 3.0]}),
        (-5.0, {"reference.z": [[*RAMPS], [*RAMPS[:1]], -3.0], "reference.x": [1.0, 2.0], "lam": [0.1, 0.2]}),
    ],
    ids=["no ramp", "ramps", "numbers in place of ramps", "ramps among the choices"],
)
def test_the_scored_time_is_that_of_the_experiment(base: Any, axes: dict[str, Any]) -> None:
    experiment = {**DATA["experiment"], "duration": 2.0, "reference": {"z": base}}
    plan = make_plan(SweepSpec.from_dict({**DATA, "experiment": experiment, "sweep": {"kind": "grid", "axes": axes}}))
    columns = plan.space.columns(plan.rows) | {"row": plan.rows}
    result = Result(plan, columns)
    for place, found in enumerate(scored_time(plan, columns)):
        exact = result.experiment(place)
        assert found == pytest.approx(exact.scored[1].sum(axis=0).min() * exact.sampling_time, abs=0.009)


def test_the_bound_is_bounded() -> None:
    with pytest.raises(InputError, match=r"sweep\.decide"):
        SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], "decide": -1}})
