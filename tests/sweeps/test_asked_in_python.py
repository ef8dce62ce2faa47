"""What is asked of a sweep in Python: counts, places and limits of numpy too, and wrong ones told before any work."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import InputError
from sweeps.goal import SweepGoal
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec

pytestmark = pytest.mark.once

Finished = tuple[Path, Result]
NO_COUNTS = (0, -1, 2.0, "2", None, True, np.nan, np.array([1]))
NAN = float("nan")


@pytest.mark.parametrize("wrong", ["spec.toml", None, 3])
def test_what_is_no_sweep_is_told(wrong: Any, tmp_path: Path) -> None:
    """The path of a spec in place of the spec was "'str' object has no attribute 'experiment'"."""
    with pytest.raises(InputError, match=r"must be of the type SweepSpec.*SweepSpec\.from_toml"):
        run(wrong, tmp_path / "new")
    assert not (tmp_path / "new").exists()
    with pytest.raises(InputError, match="must be a table"):
        SweepSpec.from_dict(wrong)


@pytest.mark.parametrize("n", NO_COUNTS)
def test_the_best_are_counted(finished: Finished, n: Any) -> None:
    """The best −1 were all but the worst."""
    with pytest.raises(InputError, match=r"^n = .*: must be a whole number of at least 1"):
        finished[1].best(n)


def test_numbers_of_numpy_count_places_and_limits(finished: Finished) -> None:
    _, result = finished
    assert result.best(np.int64(2), np.float32(2.0))["row"].tolist() == result.best(2, 2.0)["row"].tolist()
    assert result.settings(np.int64(-1)) == result.settings(-1)
    assert result.controller(np.int8(3)).to_dict() == result.controller(3).to_dict()


@pytest.mark.parametrize("limit", [NAN, float("inf"), "2", True, -1.0, 1.0])
def test_a_limit_of_the_best_is_one_that_a_loop_may_keep(finished: Finished, limit: Any) -> None:
    with pytest.raises(InputError, match=r"M_s = .*: must be a number above 1"):
        finished[1].best(3, limit)


@pytest.mark.parametrize("place", [10_000, -10_000, 1.0, "1", None, True])
def test_a_place_is_one_of_a_row(finished: Finished, place: Any) -> None:
    for asked in (finished[1].settings, finished[1].controller, finished[1].experiment):
        with pytest.raises(InputError, match=r"^place = .*: must be of one of 120 rows"):
            asked(place)


@pytest.mark.parametrize("row", [10_000, -1, 1.0, "1", None, True, [1]])
def test_a_row_is_asked_for_by_its_number(finished: Finished, row: Any) -> None:
    """True was row 1."""
    with pytest.raises(InputError, match=r"^row = .*: must be one of the 120 rows"):
        finished[1].place(row)
    assert finished[1].place(np.int64(1)) == finished[1]["row"].tolist().index(1)


@pytest.mark.parametrize("goal", ["x", "", 3, {"M_s": 2.0}])
def test_a_goal_is_one(finished: Finished, goal: Any) -> None:
    """The name of what ranks was "'str' object has no attribute 'constraints'", an empty one the goal of the spec."""
    for asked in (finished[1].undecided, finished[1].ranked, finished[1].good):
        with pytest.raises(InputError, match=r"^goal = .*: must be of the type SweepGoal"):
            asked(goal)


def test_a_goal_needs_what_was_kept(spec: SweepSpec, tmp_path: Path) -> None:
    few = run(replace(spec, kept=("rms", "M_s")).only(np.array([3, 1])), tmp_path)
    for asked in (few.undecided, few.ranked, few.good):
        for goal in (SweepGoal("chatter"), SweepGoal("rms", {"chatter": 1.0})):
            with pytest.raises(InputError, match=r"^quantity = chatter: must be kept by the sweep"):
                asked(goal)


def test_the_front_leaves_rows_out_or_not(finished: Finished) -> None:
    """Any text counted as true."""
    with pytest.raises(InputError, match=r"^feasible = no: must be true or false"):
        finished[1].pareto(feasible="no")  # type: ignore[arg-type]  # on purpose


@pytest.mark.parametrize("given", [{"chunk": np.int64(50)}, {"part": (np.int64(2), np.int64(2))}])
def test_a_run_takes_numbers_of_numpy(spec: SweepSpec, finished: Finished, tmp_path: Path, given: Any) -> None:
    assert run(spec, tmp_path, **given).hash == finished[1].hash


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("chunk", value) for value in (0, -1, 2.0, True, "2")),
        *(("part", value) for value in ((0, 2), (3, 2), (-1, 2), (1, 0), (1.5, 2), (1, "2"), 3, None, (1, 2, 3))),
        *(("silence", value) for value in (0.0, -1.0, NAN, float("inf"), "60", None)),
    ],
)
def test_a_run_refuses_other_numbers_before_it_writes(spec: SweepSpec, tmp_path: Path, key: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"^{key} = "):
        run(spec, tmp_path / "run", **{key: value})
    assert not (tmp_path / "run").exists()


def test_a_goal_of_numpys_numbers_is_plain(spec: SweepSpec, tmp_path: Path) -> None:
    given = SweepGoal("rms", {"M_s": np.float32(2.0)}, np.int64(0))  # type: ignore[arg-type,dict-item]  # on purpose
    assert given == SweepGoal("rms", {"M_s": 2.0}, 0)
    few = replace(spec, goal=given).only(np.array([3, 1]))
    assert run(few, tmp_path)["row"].tolist() == [1, 3]


@pytest.mark.parametrize("decide", [-1, 1.5, True, 100_001])
def test_how_many_rows_are_decided_is_bounded(decide: Any) -> None:
    with pytest.raises(InputError, match=r"^sweep\.decide = "):
        SweepGoal(decide=decide)


@pytest.mark.parametrize("rows", [(), (-1,), (240,), (1.5,), ("1",), np.zeros(0, int)])
def test_rows_that_are_asked_for_are_there(spec: SweepSpec, rows: Any) -> None:
    with pytest.raises(InputError, match=r"^rows = "):
        spec.only(rows)


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("sweep.precision", lambda spec: replace(spec, precision="float16")),
        ("sweep.on_error", lambda spec: replace(spec, on_error=None)),
        ("sweep.on_error", lambda spec: replace(spec, on_error="go on")),
        ("sweep.columns", lambda spec: replace(spec, kept=("rms", "M_s", "foo"))),
        ("sweep.columns", lambda spec: replace(spec, kept=("rms",))),
        ("sweep.columns", lambda spec: replace(spec, kept=("M_s",))),
    ],
)
def test_a_spec_that_is_built_in_python_is_checked(
    spec: SweepSpec, key: str, change: Callable[[SweepSpec], SweepSpec]
) -> None:
    with pytest.raises(InputError, match=f"^{key} = "):
        change(spec)
