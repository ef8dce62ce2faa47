"""Which rows of a sweep are good: ranks, fronts, what stands in the way, and how much an axis matters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.report.influence import _score
from jaxmpc.status import Status
from sweeps.goal import SweepGoal
from sweeps.plan import Plan
from sweeps.result import Result
from sweeps.sensitivity import sensitivity
from sweeps.show.best_rows import table
from sweeps.show.in_the_way import in_the_way

Finished = tuple[Path, Result]
ROWS = 120


def made_up(points: np.ndarray, status: np.ndarray, plan: Plan) -> Result:
    """A result with given residual and peak sensitivity per row, (n, 2), at the first of two stiffnesses."""
    n = len(points)
    rms, M_s = np.zeros((n, 2, 3), np.float32), np.ones((n, 2))
    rms[:, 0, 2], M_s[:, 0] = points.T
    return Result(plan, {"row": np.arange(n), "status": status, "rms": rms, "M_s": M_s})


def test_a_margin_may_be_infinitely_good(finished: Finished) -> None:
    """As of a loop that no lower gain makes unstable; one that is lost has −∞."""
    n, plan = 40, finished[1].plan
    reduction = np.linspace(3.0, 20.0, n)
    reduction[[5, 6]], reduction[[7, 8]] = np.inf, -np.inf
    made = made_up(np.stack([np.linspace(0.1, 0.2, n), np.full(n, 1.5)], axis=1), np.full((n, 2), Status.OK), plan)
    made = replace(made, columns={**made.columns, "gain_reduction_db": np.repeat(reduction[:, None], 2, axis=1)})
    ranked = made.ranked(SweepGoal("gain_reduction_db", {})).tolist()
    assert ranked[:2] == [5, 6]
    assert sorted(ranked) == sorted({*range(n)} - {7, 8})
    assert {5} <= set(made.pareto("rms", "gain_reduction_db")["row"].tolist()) <= {*range(6)}
    scores = _score(reduction, floor=True)
    assert (scores[[5, 6]] > scores[-1]).all()
    assert (scores[[7, 8]] < scores[0]).all()
    lam = np.where(np.isposinf(reduction), 4.0, np.where(np.isneginf(reduction), 1.0, 2.0))
    made = replace(
        made, columns={**made.columns, "lam": lam, "T_cl": np.tile([1.0, 2.0], n // 2), "Hp": np.full(n, 10)}
    )
    # Where infinitely good counted as lost, lam would explain nothing.
    assert sensitivity(made, "gain_reduction_db")["lam"].share > 0.3


def test_what_stands_in_the_way_is_told_where_no_row_is_good(finished: Finished) -> None:
    points = np.array([[0.1, 2.5], [0.2, 1.9], [0.3, 2.2], [0.01, 1.5]])
    status = np.full((4, 2), Status.OK)
    status[3, 1] = Status.DIVERGED
    made = made_up(points, status, finished[1].plan)
    assert in_the_way(made, SweepGoal()) == [], "row 1 is good"
    goal = SweepGoal(constraints={"M_s": 2.0, "rms": 0.15})
    assert in_the_way(made, goal) == [
        "3 of 4 rows are OK at every stiffness; of these 1 keeps M_s ≤ 2 (best 1.9, row 1), "
        "1 keeps rms ≤ 0.15 (best 0.1, row 0)",
        "nearest is row 0, which misses M_s with 2.5",
    ]
    assert "\n".join(["no row: " + goal.text + ", at every stiffness", *in_the_way(made, goal)]) == table(
        replace(made, plan=replace(made.plan, goal=goal))
    )
    lost = made_up(points, np.full((4, 2), Status.UNSTABLE), finished[1].plan)
    assert in_the_way(lost, goal) == ["0 of 4 rows are OK at every stiffness"]


def test_a_row_that_failed_is_on_no_front_and_explains_what_was_lost(finished: Finished) -> None:
    n, plan = 40, finished[1].plan
    status = np.full((n, 2), Status.OK)
    status[:10, 1] = Status.DIVERGED
    made = made_up(np.stack([np.linspace(0.1, 0.2, n), np.linspace(1.2, 1.9, n)], axis=1), status, plan)
    extra = {"gain_margin_db": np.full((n, 2), 9.0), "clamped": np.zeros((n, 2, 3)), "Hp": np.full(n, 10)}
    extra |= {"lam": np.repeat([1.0, 2.0, 3.0, 4.0], 10), "T_cl": np.tile([1.0, 2.0], n // 2)}
    made = replace(made, columns={**made.columns, **extra})
    assert made.pareto("M_s", "gain_margin_db")["row"].tolist() == [10]
    # All others have none: lam alone decides who is lost.
    found = sensitivity(made, "clamped")
    assert found["lam"].share > 0.9
    assert found["T_cl"].share < 0.1


@pytest.mark.parametrize("seed", range(4))
def test_the_front_is_the_one_of_brute_force(seed: int, finished: Finished) -> None:
    random = np.random.default_rng(seed)
    # Few distinct values, so that there are ties and repetitions of every kind.
    rms = random.integers(1, 12, 80)
    points = np.stack([rms, 13 - rms + random.integers(0, 4, 80)], axis=1).astype(float)
    status = np.where(random.random((80, 2)) < 0.1, Status.DIVERGED, Status.OK)
    result = made_up(points, status, finished[1].plan)
    ok = (status == Status.OK).all(axis=1)
    beaten = [
        any(ok[j] and (points[j] <= points[i]).all() and (points[j] < points[i]).any() for j in range(80))
        for i in range(80)
    ]
    expected = np.flatnonzero(ok & ~np.array(beaten))
    assert 5 < len(expected) < 80
    front = result.pareto()
    assert sorted(front["row"]) == expected.tolist()
    assert (np.diff(front.worst("M_s")) >= 0).all()


def test_the_best_rows_are_robust_and_ordered(finished: Finished) -> None:
    points = np.array([[0.1, 3.0], [0.4, 1.5], [0.2, 2.0], [0.05, 1.2], [0.3, np.nan]])
    status = np.zeros((5, 2), int)
    status[3, 1] = Status.UNSTABLE
    result = made_up(points, status, finished[1].plan)
    assert result.best(10, 2.0)["row"].tolist() == [2, 1]
    assert result.best(1, 3.5)["row"].tolist() == [0]
    assert result.worst("rms")[3] == np.inf
    assert result.worst("M_s")[4] == np.inf


@pytest.mark.parametrize("rows", [20, 60, 400])
def test_an_axis_without_effect_explains_little_where_no_value_stands_twice(rows: int, finished: Finished) -> None:
    """As in a refined sweep, whose rows lie anywhere, though its first stage was a grid."""
    random, result = np.random.default_rng(rows), finished[1]
    lam, T_cl = np.exp(random.uniform(-7, 2, rows)), random.uniform(1e-3, 2e-2, rows)
    made = made_up(np.stack([lam**0.2, np.full(rows, 1.5)], axis=1), np.full((rows, 2), Status.OK), result.plan)
    columns = {**made.columns, "lam": lam, "T_cl": T_cl, "Hp": np.full(rows, 10.0)}
    found = sensitivity(replace(made, columns=columns, stages=(("0-full", result),)), "rms")
    assert found["lam"].share > 0.5
    assert found["T_cl"].share < 0.35
    assert found["Hp"].share == 0.0
