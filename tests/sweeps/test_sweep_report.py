"""The report of a sweep: its rows, its front, the controller of each."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from jaxmpc.report.content import Detail, Report
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps.axis import SweepAxis
from sweeps.judged import Point
from sweeps.plan import Plan, describe, make_plan
from sweeps.result import Result, of_stages
from sweeps.show import report
from sweeps.show.best_rows import table
from sweeps.show.candidates import candidates, template
from sweeps.show.curves import length_words, note, world_words
from sweeps.show.report import sweep_report
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec

Finished = tuple[Path, Result]
ROWS = 120
LIMIT = 50.0
"""Of M_s, which some rows keep [-]."""


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


def test_a_report_says_what_rows_met_where_that_is_swept(finished: Finished) -> None:
    plan = finished[1].plan
    assert (world_words(finished[1]), length_words(finished[1])) == ("linear loop", "1 s")
    assert "the last 1 s of the residual" in note(finished[1], 3), "no more than a run has"
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


def test_the_params_toml_of_a_row_says_in_words_what_it_met(finished: Finished) -> None:
    """It said "It met physics = 1", which nobody can know who has that file alone."""
    plan = finished[1].plan
    axes: tuple[SweepAxis, ...] = (SweepAxis("physics", "choice", ("linear", "wam")),)
    axes += (SweepAxis("motion.seed", "list", (20261129.0, 5.0)),)
    axes += (SweepAxis("stiffness", "list", (0.5,), relative=True),)
    space = SweepSpace("grid", tuple((axis,) for axis in axes), 4, 0, plan.space.horizons)
    swept = Plan({**plan.canonical, "space": msgspec.to_builtins(space)})
    pieces = template(Result(swept, {"row": np.arange(4), **space.columns(np.arange(4))}))
    text = "".join(piece if isinstance(piece, str) else f"<{piece.name}>" for piece in pieces)
    assert "# It met physics = <physics> (0: linear; 1: wam)\n# It met motion.seed = <motion.seed>\n" in text
    assert "# It met stiffness = <stiffness> times the base\n" in text
    assert "motion.seed 5 … 20261129, 2 values" in describe(swept)


def test_what_counts_is_written_as_a_whole_number() -> None:
    """A params.toml with `disturbance_order = 2.0` is refused by whatever takes it."""
    counted, other = ("delay", "disturbance_order", "designed_delay", "Hp"), ("K2", "sensor.noise")
    sweep = {"kind": "grid", "axes": {**{key: [1, 2] for key in counted}, **{key: [10.0, 20.0] for key in other}}}
    plan = make_plan(SweepSpec.from_dict({"params": {"Hu": 1}, "sweep": sweep}))
    columns = {name: np.zeros((len(plan.rows), *column.shape), column.dtype) for name, column in plan.layout.items()}
    columns |= {"row": plan.rows, **plan.space.columns(plan.rows)}
    rows = candidates(Result.of(plan, columns, np.ones(len(plan.rows), bool)))
    assert {each.name: each.whole for each in rows.measures if each.role == "parameter"} == {
        name: name in counted for name in (*counted, *other)
    }


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


@pytest.mark.parametrize("lost", [False, True])
def test_what_ran_once_more_is_reported_whatever_it_was_before(
    lost: bool, finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of more rows than a page shows, the best once more may be none of those that are shown; or a chunk is gone."""
    whole = finished[1]
    matter = np.isin(whole["row"], [*whole.best(1000, LIMIT)["row"], *whole.pareto()["row"]])
    (poor,) = np.flatnonzero(~matter)[:1]
    once_more = whole.best(1, LIMIT)
    once_more = replace(once_more, columns={**once_more.columns, "row": whole["row"][[poor]]})
    before = whole.take(np.arange(len(whole)) != poor) if lost else whole
    found = of_stages([("0-full", before), ("1-rerun", once_more)], ended=True)
    told: list[Report] = []
    monkeypatch.setattr(report, "write_report", lambda content, path: told.append(content))
    monkeypatch.setattr(report, "details", lambda result, places: {place: Detail() for place in places})
    monkeypatch.setattr(report, "MOST_ROWS", int(matter.sum()))
    sweep_report(found, tmp_path / "report.html", LIMIT)
    rows, again = told[0].rows, told[0].sections[0].tables[0].rows
    assert rows is not None
    row = f"row {whole['row'][poor]}"
    assert (row in {rows.names[place] for place in rows.details}) is not lost
    assert [line[-1] for line in again] == ["–"]  # it had no rank


@pytest.mark.parametrize(
    ("point", "words"),
    [
        (Point(0.0652, 4.52), "Worst RMS 65.2 mN, worst M_s 4.52."),
        (Point(np.inf, np.inf), "It is not OK at every stiffness."),
    ],
)
def test_a_base_that_is_lost_has_no_infinite_residual(
    finished: Finished, tmp_path: Path, point: Point, words: str
) -> None:
    """As the paper's printed gains are on its own foam."""
    page = tmp_path / "report.html"
    sweep_report(replace(finished[1], baseline=point), page, curves=False)
    assert words in page.read_text()
