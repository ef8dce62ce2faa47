"""Which rows of made-up numbers float32 leaves undecided, and which of them come first."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jaxmpc.quantities import METRICS
from jaxmpc.status import Status
from sweeps.goal import SweepGoal
from sweeps.met import scored_time
from sweeps.plan import make_plan
from sweeps.spec import SweepSpec
from sweeps.undecided import IN_FLOAT64, TOP, amplification, undecided

GOAL = SweepGoal("rms", {"M_s": 2.0})


def columns_of(rows: int, **given: Any) -> dict[str, np.ndarray]:
    """So many rows on two tissues, far apart and far from every limit but for what is given, (rows,) or (rows, 2)."""
    rms = 0.02 * 1.3 ** np.arange(rows)
    columns = {"rms": rms, "M_s": np.full(rows, 1.5), "peak_force": np.full(rows, 5.0), "clamped": np.zeros(rows)}
    columns |= {"status": np.full(rows, Status.OK), **given}
    full = {name: np.zeros((rows, 2, 3)) for name in METRICS}
    for name, values in columns.items():
        cells = np.broadcast_to(np.reshape(values, (rows, -1)), (rows, 2)).copy()
        full[name] = np.repeat(cells[:, :, None], 3, axis=2) if name in METRICS else cells
    return {**full, "row": np.arange(rows), IN_FLOAT64: np.zeros(rows, bool)}


def found(drawn: SweepSpec, columns: dict[str, np.ndarray], goal: SweepGoal = GOAL) -> list[int]:
    return undecided(replace(make_plan(drawn), goal=goal), columns).tolist()


def close(rows: int, pair: int) -> np.ndarray:
    """RMS of rows of which one has nearly that of the next."""
    rms = 0.02 * 1.3 ** np.arange(rows)
    rms[pair + 1] = 1.001 * rms[pair]
    return rms


@pytest.mark.parametrize("rows", [TOP, TOP + 1, TOP + 5])
def test_order_counts_among_the_ten_best_alone(drawn: SweepSpec, rows: int) -> None:
    for pair in range(rows - 1):
        wanted = [pair, pair + 1] if pair < TOP else []
        assert found(drawn, columns_of(rows, rms=close(rows, pair))) == wanted


@pytest.mark.parametrize("lost", ["M_s", "status", "near"])
def test_ten_others_must_be_better_for_sure(drawn: SweepSpec, lost: str) -> None:
    """The best row is lost by a margin, or on one tissue by its force, or may be; then ten are left."""
    rows, limit = TOP + 3, make_plan(drawn).canonical["experiment"]["force_limit"]
    M_s, status, force = np.full(rows, 1.5), np.full((rows, 2), Status.OK), np.full((rows, 2), 5.0)
    M_s[0] = 2.5 if lost == "M_s" else 1.5
    if lost != "M_s":
        status[0, 1] = Status.FORCE_LIMIT if lost == "status" else Status.OK
        force[0, 1] = 2.0 * limit if lost == "status" else 0.99 * limit
    for pair, open_rank in ((TOP, [TOP, TOP + 1]), (TOP + 1, [])):
        columns = columns_of(rows, rms=close(rows, pair), M_s=M_s, status=status, peak_force=force)
        assert found(drawn, columns) == [0] * (lost == "near") + open_rank


def test_a_row_that_may_be_good_at_all_comes_before_those_that_are_near_a_limit(drawn: SweepSpec) -> None:
    limit = make_plan(drawn).canonical["experiment"]["force_limit"]
    status, force = np.full(TOP + 3, Status.OK), np.full(TOP + 3, 5.0)
    status[1], force[1] = Status.FORCE_LIMIT, 1.01 * limit  # second best, or lost
    force[0] = force[TOP + 2] = 0.99 * limit
    assert found(drawn, columns_of(TOP + 3, status=status, peak_force=force)) == [0, 1, TOP + 2]
    rms = 0.02 * 1.3 ** np.arange(TOP + 3)[::-1]
    assert found(drawn, columns_of(TOP + 3, rms=rms, status=status, peak_force=force)) == [TOP + 2, 1, 0]


def test_first_what_may_be_good_then_what_is_near_a_limit_then_what_nothing_is_known_of(drawn: SweepSpec) -> None:
    limit = make_plan(drawn).canonical["experiment"]["force_limit"]
    rows = TOP + 5
    status, force, clamped, chatter = np.full(rows, Status.OK), np.full(rows, 5.0), np.zeros(rows), np.zeros(rows)
    clamped[0] = 0.1
    force[1], chatter[1] = 0.99 * limit, 2.0  # beyond a constraint, whatever its status is
    status[2], force[2] = Status.FORCE_LIMIT, 1.01 * limit
    force[rows - 1] = 0.99 * limit
    columns = columns_of(rows, status=status, peak_force=force, clamped=clamped, chatter=chatter)
    assert found(drawn, columns, SweepGoal("rms", {"chatter": 1.0})) == [2, 1, rows - 1, 0]


def test_what_ran_in_float64_is_decided_though_another_may_be_better(drawn: SweepSpec) -> None:
    columns = columns_of(3, rms=close(3, 0))
    columns[IN_FLOAT64][1] = True
    assert found(drawn, columns) == [0]


@pytest.mark.parametrize(("name", "good", "bad"), [("M_s", 2.0, 2.0001), ("gain_margin_db", 6.0, 5.999)])
def test_a_margin_is_certain_up_to_its_limit(drawn: SweepSpec, name: str, good: float, bad: float) -> None:
    limit = {"M_s": 2.0, "gain_margin_db": 6.0}[name]
    for value, wanted in ((good, [0, 1]), (bad, [])):
        columns = columns_of(3, rms=close(3, 0), **{name: [value, limit, limit]})
        assert found(drawn, columns, SweepGoal("rms", {name: limit})) == wanted


@pytest.mark.parametrize("lost", [Status.UNSTABLE, Status.ILL_POSED, Status.FORCE_LIMIT])
def test_a_row_counts_on_all_its_tissues(drawn: SweepSpec, lost: Status) -> None:
    """Lost on one it is no rival of others; near a limit on one alone it is undecided."""
    limit = make_plan(drawn).canonical["experiment"]["force_limit"]
    status, rms = np.full((3, 2), Status.OK), np.repeat(close(3, 0)[:, None], 2, axis=1)
    force = np.full((3, 2), 5.0)
    status[0, 1], force[0, 1] = lost, 2.0 * limit if lost == Status.FORCE_LIMIT else np.nan
    if lost != Status.FORCE_LIMIT:
        rms[0, 1] = np.nan
    assert found(drawn, columns_of(3, rms=rms, status=status, peak_force=force)) == []
    force[2, 0] = 0.99 * limit
    assert found(drawn, columns_of(3, rms=rms, status=status, peak_force=force)) == [2]


def test_rows_that_may_be_good_run_before_those_that_are_lost_anyway(drawn: SweepSpec) -> None:
    """A torque limit acts in all: first by rank, then those beyond a margin, unstable on a tissue, or no number."""
    rms: Sequence[Any] = [[0.02, 0.02], [0.03, 0.03], [0.04, 0.04], [0.05, np.nan], [np.nan, np.nan], [0.06, 0.06]]
    status = np.full((6, 2), Status.OK)
    status[3, 1], status[4] = Status.UNSTABLE, Status.DIVERGED
    clamped = np.full((6, 2), 0.1)
    clamped[3, 1], clamped[4] = np.nan, np.nan
    columns = columns_of(6, rms=rms, status=status, clamped=clamped, M_s=[1.5, 2.5, 1.5, 1.5, 1.5, 1.5])
    assert found(drawn, columns) == [0, 2, 5, 1, 3, 4]


def test_errors_grow_below_four_seconds_and_above_a_sensitivity_of_three(drawn: SweepSpec) -> None:
    plan, columns = make_plan(drawn), columns_of(4, M_s=[1.5, 3.0, 6.0, np.inf])
    columns |= plan.space.columns(plan.rows[:4])
    expected = np.sqrt(4.0 / scored_time(plan, columns)) * [1.0, 1.0, 2.0, 1.0]
    np.testing.assert_allclose(amplification(plan, columns), expected)
