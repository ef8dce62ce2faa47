"""What `jaxmpc sweep best | pareto | row | sensitivity` show, and refuse to."""

import os
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sweeps.axis import SweepAxis
from sweeps.plan import Plan
from sweeps.result import Result
from sweeps.sensitivity import sensitivity
from sweeps.show.best_rows import table
from sweeps.show.cli import TAKES
from sweeps.show.tables import row_sheet, rows_table, sensitivity_table
from sweeps.space import SweepSpace

Finished = tuple[Path, Result]
ROWS = 120


@pytest.mark.parametrize("verb", ["best", "pareto", "row", "sensitivity", "report"])
@pytest.mark.parametrize(("flag", "name"), [("--csv", "rows.csv"), ("--params", "rows.toml")])
def test_what_cannot_be_written_is_refused_before_anything_is_shown(
    verb: str,
    flag: str,
    name: str,
    finished: Finished,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    if flag not in TAKES[verb]:
        pytest.skip("that verb does not take it")
    fifo, number = tmp_path / name, ["7"] if verb == "row" else []
    os.mkfifo(fifo)
    folder = tmp_path / f"folder-{name}"
    folder.mkdir()
    for path in (fifo, folder, tmp_path / "nowhere" / name):
        assert command("sweep", verb, finished[0], *number, flag, path) == 2
        said = capsys.readouterr()
        assert (said.out, said.err.count("\n")) == ("", 1)
    assert stat.S_ISFIFO(fifo.stat().st_mode)


def test_what_best_shows_is_headed_by_the_limit_it_was_asked_with(
    finished: Finished, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("sweep", "best", finished[0], "--max-ms", 1.01) == 0
    said = capsys.readouterr().out
    assert "M_s ≤ 1.01" in said
    assert "M_s ≤ 2" not in said


@pytest.mark.parametrize("limit", ["0.9", "inf", "nan"])
def test_a_limit_that_none_is_is_told_of_its_flag(
    limit: str, finished: Finished, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("sweep", "best", finished[0], "--max-ms", limit) == 2
    assert f"--max-ms = {limit}: must be a number above 1" in capsys.readouterr().err


def test_where_no_row_is_good_params_are_not_written(
    finished: Finished, command: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in "best", "sensitivity":
        assert command("sweep", verb, finished[0], "--max-ms", 1.01, "--params", tmp_path / "params.toml") == 2
        said = capsys.readouterr().err
        assert f"`jaxmpc sweep best {finished[0]}` tells what stands in the way" in said
        assert not (tmp_path / "params.toml").exists()
    both = "--params", tmp_path / "params.toml", "--csv", tmp_path / "rows.csv"
    assert command("sweep", "best", finished[0], "--max-ms", 1.01, *both) == 2
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("row", ["²", "9" * 5000, "-1", "x"])
def test_no_number_of_a_row(row: str, finished: Finished, command: Callable[..., int]) -> None:
    assert command("sweep", "row", finished[0], row) == 2


def test_tables_show_no_torque_of_a_loop_without_joints(
    finished: Finished, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    result = finished[1]
    joints = ["clamped [%]", "joint torque [N m]", "torque step [N m]"]
    sheet = row_sheet(result.best(1, 5.0)).splitlines()
    shown = [line.split("  ")[0] for line in sheet if line.count(" –") == 2]
    assert set(shown) == {f"{name} {axis}" for name in (*joints, "swing [mN]") for axis in "xyz"}
    axes = (SweepAxis("physics", "choice", ("linear", "wam")),)
    space = SweepSpace("grid", (axes,), 2, 0, result.plan.space.horizons)
    plan = Plan({**result.plan.canonical, "space": msgspec.to_builtins(space)})
    both = Result(plan, {**result.best(2, 5.0).columns, "physics": np.array([0.0, 1.0])})
    linear, arm = rows_table(both, "rows", ["torque_step"]).splitlines()[2:]
    assert (linear.split()[2], arm.split()[2]) == ("–", "0")
    assert command("sweep", "pareto", finished[0], "--goals", "rms,torque_step") == 2
    assert "--goals = torque_step: must be what the linear loop measures" in capsys.readouterr().err


def test_the_rows_that_are_listed_are_written(
    finished: Finished, command: Callable[..., int], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole, goals = len(finished[1].pareto("rms", "M_s", "effort")), ("--goals", "rms,M_s,effort")
    assert whole > 2
    for flags, count in ((("-n", 2), 2), ((), whole)):
        assert command("sweep", "pareto", finished[0], *goals, *flags, "--csv", tmp_path / "rows.csv") == 0
        listed = capsys.readouterr().out.splitlines()
        assert listed[0].startswith(
            f"Pareto front of rms, M_s, effort, {f'{count} of {whole}' if flags else count} rows;"
        )
        assert len((tmp_path / "rows.csv").read_text().splitlines()) == 1 + 2 * count
        assert len([line for line in listed[2:] if line[0].isdigit()]) == count


def test_what_does_not_vary_has_no_correlation(finished: Finished) -> None:
    told = sensitivity_table(finished[1].take(slice(1)))
    assert "nan" not in told
    assert told.splitlines()[2].split()[3] == "–"


@pytest.mark.filterwarnings("error")
def test_one_axis_explains_nothing_of_what_does_not_vary(finished: Finished) -> None:
    """Its share was 100 %, beside a warning of scipy's: of equal numbers numpy's deviation need not be 0."""
    plan, rows = finished[1].plan, np.arange(5)
    space = SweepSpace("grid", ((SweepAxis("K2", "list", (5.0, 6.0, 7.0, 8.0, 9.0)),),), 5, 0, plan.space.horizons)
    M_s = np.full((5, 2), 1.2345)
    assert np.log(M_s[:, 0]).std() > 0.0
    columns = {"row": rows, **space.columns(rows), "status": np.zeros((5, 2), np.int8), "M_s": M_s}
    result = Result(Plan({**plan.canonical, "space": msgspec.to_builtins(space)}), columns)
    rounded = replace(result, columns={**columns, "M_s": M_s * (1.0 + 2e-16 * rows[:, None])})
    for each in (result, rounded):
        found = sensitivity(each, "M_s")["K2"]
        assert found.share == 0.0
        assert np.isnan(found.correlation)
    varied = replace(result, columns={**columns, "M_s": M_s + rows[:, None]})
    assert sensitivity(varied, "M_s")["K2"] == (1.0, pytest.approx(1.0))


def test_what_is_infinitely_good_is_shown_alike_by_every_table(finished: Finished) -> None:
    best = finished[1].best(1, 5.0)
    endless = replace(best, columns=best.columns | {"gain_reduction_db": np.full((1, 2), np.inf)})
    for shown in (rows_table(endless, "best"), row_sheet(endless), table(endless, 1, 5.0)):
        assert "∞" in shown
        assert "inf" not in shown


def test_a_reader_who_has_had_enough_is_no_failure(finished: Finished) -> None:
    """As `head` behind a pipe; what is told at once needs no buffer to be full."""
    read, write = os.pipe()
    os.close(read)
    line = [sys.executable, "-u", "-m", "jaxmpc", "sweep", "pareto", finished[0]]
    try:
        found = subprocess.run(line, stdout=write, stderr=subprocess.PIPE)
    finally:
        os.close(write)
    assert (found.returncode, found.stderr) == (141, b"")


def test_the_table_says_when_nothing_is_robust(finished: Finished) -> None:
    assert "M_s ≤ 1.01" in table(finished[1], 3, 1.01)
