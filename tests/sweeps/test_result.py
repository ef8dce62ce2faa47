"""What is made of a result: best rows, Pareto front, exports, figures, table."""

import csv
import os
import stat
import subprocess
import sys
import tomllib
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.report.influence import _score
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps import labelled
from sweeps.axis import SweepAxis
from sweeps.goal import SweepGoal
from sweeps.judged import Point
from sweeps.plan import Plan
from sweeps.result import Result
from sweeps.sensitivity import sensitivity
from sweeps.show.best_rows import table
from sweeps.show.candidates import candidates, template
from sweeps.show.cli import TAKES
from sweeps.show.curves import length_words, world_words
from sweeps.show.in_the_way import in_the_way
from sweeps.show.report import sweep_report
from sweeps.show.tables import row_sheet, rows_table
from sweeps.space import SweepSpace
from sweeps.store import stage_folders

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


def test_a_row_is_a_controller(finished: Finished) -> None:
    _, result = finished
    controller, base = result.controller(7), Params.published("text")
    for name in ("lam", "T_cl", "Hp"):
        assert float(getattr(controller, name)) == result[name][7]
    assert float(controller.K2) == float(base.K2)
    assert controller.batch_shape == ()


def test_the_baseline_is_the_base_controller(finished: Finished) -> None:
    _, result = finished
    assert result.baseline is not None
    # λ = 0.1 and T_cl = 4.47e-3 are on the grid, the text design's T_cl = 3e-3 is not; M_s is the published one.
    assert result.baseline.M_s == pytest.approx(4.53, rel=0.01)


def test_counts_add_up(finished: Finished) -> None:
    _, result = finished
    counts = result.status_counts()
    assert sum(counts.values()) == 2 * ROWS
    assert counts["OK"] == (result["status"] == 0).sum() > 0
    assert counts["UNSTABLE"] == np.isinf(result["M_s"]).sum() > 0


def test_an_unknown_column_is_named(finished: Finished) -> None:
    with pytest.raises(InputError, match="Did you mean 'M_s'"):
        finished[1]["Ms"]


def test_csv_holds_every_row_and_stiffness(finished: Finished, tmp_path: Path) -> None:
    _, result = finished
    result.to_csv(tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * ROWS
    last = rows[-1]
    assert int(last["row"]) == result["row"][-1]
    assert float(last["T_cl [s]"]) == result["T_cl"][-1]
    assert (float(last["stiffness [N/m]"]), last["status"]) == (1900.0, Status(result["status"][-1, 1]).name)
    assert float(last["rms_z [N]"]) == result["rms"][-1, 1, 2]
    assert [row["in_float64"] == "True" for row in rows[::2]] == result["in_float64"].tolist()
    assert float(last["delay_margin_s [s]"]) == result["delay_margin_s"][-1, 1]


def test_a_csv_takes_little_memory_beside_the_result(
    finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished[1].to_csv(tmp_path / "at once.csv")
    monkeypatch.setattr(labelled, "LINES", 50)
    finished[1].to_csv(tmp_path / "pieces.csv")
    assert (tmp_path / "pieces.csv").read_bytes() == (tmp_path / "at once.csv").read_bytes()
    many = finished[1].take(np.tile(np.arange(ROWS), 20))
    columns = sum(values.nbytes for _, _, values in labelled._table(many))
    tracemalloc.start()
    try:
        many.to_csv(tmp_path / "many.csv")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # All lines at once are ten times the columns, as Python's numbers and as text.
    assert peak < 2 * columns


def test_xarray_has_dimensions_coordinates_and_units(finished: Finished) -> None:
    pytest.importorskip("xarray")
    _, result = finished
    data = result.to_xarray()
    assert data["rms"].dims == ("row", "stiffness", "axis")
    assert data["M_s"].dims == data["status"].dims == ("row", "stiffness")
    assert data["in_float64"].values.tolist() == result["in_float64"].tolist()
    assert data.sizes == {"row": ROWS, "stiffness": 2, "axis": 3}
    known = {**METRICS, **MARGINS}
    assert {name: data[name].attrs["units"] for name in known} == {name: row.unit for name, row in known.items()}
    assert data["T_cl"].attrs["units"] == "s"
    assert data.attrs["result_hash"] == result.hash
    row = int(result["row"][5])
    assert data["rms"].sel(row=row, stiffness=375.0, axis="z") == result["rms"][5, 0, 2]


def test_without_xarray_the_extra_is_named(finished: Finished, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r"jaxmpc\[analysis\]"):
        finished[1].to_xarray()


@pytest.mark.slow
def test_report_writes_the_page_and_the_best_controller(
    finished: Finished, command: Callable[..., int], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, result = finished
    before = sorted(folder.rglob("*"))
    out = tmp_path / "out"
    arguments = ("sweep", "report", folder, "-o", out, "--csv", tmp_path / "all.csv", "--max-ms", 5, "-n", 3)
    assert command(*arguments) == 0
    said = capsys.readouterr().out
    best = result.best(3, 5.0)
    assert len(best) == 3
    assert table(result, 3, 5.0) in said
    assert result.hash in said
    assert {path.name for path in out.iterdir()} == {"report.html", "best.toml"}
    values = tomllib.loads((out / "best.toml").read_text())["params"]
    assert (values["lam"], values["T_cl"], values["Hp"]) == (best["lam"][0], best["T_cl"][0], best["Hp"][0])
    assert Params.from_toml(out / "best.toml").to_dict() == best.controller(0).to_dict()
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("verb", ["best", "pareto", "row", "sensitivity", "report"])
@pytest.mark.parametrize("flag", ["--csv", "--params"])
def test_what_cannot_be_written_is_refused_before_anything_is_shown(
    verb: str,
    flag: str,
    finished: Finished,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    if flag not in TAKES[verb]:
        pytest.skip("that verb does not take it")
    fifo, number = tmp_path / "rows", ["7"] if verb == "row" else []
    os.mkfifo(fifo)
    for path in (fifo, tmp_path, tmp_path / "nowhere" / "rows"):
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
    assert f"--max-ms = {limit}: must be at least 1, and finite" in capsys.readouterr().err


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


def test_a_row_that_is_not_there_has_neither_controller_nor_experiment(finished: Finished) -> None:
    best = finished[1].best(1, 1.01)
    for asked in best.controller, best.experiment:
        with pytest.raises(InputError, match=r"0 rows.*that keep the constraints"):
            asked(0)
    with pytest.raises(InputError):
        finished[1].controller(len(finished[1]))


@pytest.mark.parametrize("row", ["²", "9" * 5000, "-1", "x"])
def test_no_number_of_a_row(row: str, finished: Finished, command: Callable[..., int]) -> None:
    assert command("sweep", "row", finished[0], row) == 2


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


def test_stages_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    names = ["0-full", "1-around", "2-around", "9-around", "10-rerun"]
    for name in (*reversed(names), "3-begun"):
        (tmp_path / "stages" / name).mkdir(parents=True)
    for name in names:
        (tmp_path / "stages" / name / "manifest.json").touch()
    assert [path.name for path in stage_folders(tmp_path)] == names


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


def test_a_report_says_what_rows_met_where_that_is_swept(finished: Finished) -> None:
    plan = finished[1].plan
    assert (world_words(finished[1]), length_words(finished[1])) == ("linear loop", "1 s")
    axes = (SweepAxis("physics", "choice", ("linear", "wam")), SweepAxis("duration", "list", (0.5, 2.0), True))
    space = SweepSpace("grid", tuple((axis,) for axis in axes), 4, 0, plan.space.horizons)
    swept = Plan({**plan.canonical, "space": msgspec.to_builtins(space)})
    result = Result(swept, {"row": np.arange(4), **space.columns(np.arange(4))})
    assert (world_words(result), length_words(result)) == ("linear loop and arm", "0.5 to 2 s")


def test_a_report_has_the_rows_of_the_sweep(finished: Finished) -> None:
    _, result = finished
    rows = candidates(result, 5.0)
    assert len(rows) == ROWS
    by_name = {each.name: each for each in rows.measures}
    np.testing.assert_array_equal(by_name["T_cl"].values, result["T_cl"])
    np.testing.assert_allclose(by_name["M_s"].values, result["M_s"])
    good = np.isfinite(result.worst("rms")) & (result.worst("M_s") <= 5.0)
    np.testing.assert_array_equal(rows.feasible, good)
    np.testing.assert_allclose(by_name["rms"].worst[good], 1e3 * result.worst("rms")[good])
    shares = rows.influence["M_s"]
    assert shares.shape == (3, 1 + 2)
    # λ and T_cl make a loop fast or slow; the horizon hardly does.
    assert shares[2, 0] < 0.1 < shares[:2, 0].max()


@pytest.mark.parametrize(
    ("best", "goals"),
    [
        ("rms", ("rms", "M_s", "chatter")),
        ("true_rms", ("true_rms", "M_s", "chatter")),
        ("M_s", ("M_s", "rms", "chatter")),
    ],
)
def test_a_front_has_one_residual(best: str, goals: tuple[str, ...], finished: Finished) -> None:
    result = finished[1]
    ranked = replace(result, plan=replace(result.plan, goal=msgspec.structs.replace(result.goal, best=best)))
    assert tuple(candidates(ranked).goals) == goals


def test_the_params_toml_of_a_row_is_its_controller(finished: Finished, tmp_path: Path) -> None:
    _, result = finished
    pieces = template(result)
    values = {"row": "row 7", **{name: result[name][7].item() for name in ("lam", "T_cl", "Hp")}}
    text = "".join(piece if isinstance(piece, str) else str(values[piece.name]) for piece in pieces)
    (tmp_path / "params.toml").write_text(text)
    assert Params.from_toml(tmp_path / "params.toml").to_dict() == result.controller(7).to_dict()


def test_a_report_stands_a_sweep_in_which_everything_failed(finished: Finished, tmp_path: Path) -> None:
    _, result = finished
    columns = dict(result.columns) | {
        "status": np.full_like(result["status"], Status.UNSTABLE),
        "M_s": np.full_like(result["M_s"], np.inf),
        "rms": np.full_like(result["rms"], np.nan),
    }
    failed = replace(result, columns=columns, baseline=Point(np.inf, np.inf))
    sweep_report(failed, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 500_000
    assert "0 of 120 rows are OK" in table(failed)
