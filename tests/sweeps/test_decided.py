"""Rows that float32 cannot decide run once more in float64: in folders, resumed, told."""

import importlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.quantities import METRICS
from sweeps import crew
from sweeps.compute import baseline
from sweeps.dry_run import dry_run
from sweeps.goal import SweepGoal
from sweeps.plan import Columns, Plan, make_plan
from sweeps.refine.run import described
from sweeps.result import Result
from sweeps.run import run
from sweeps.show.best_rows import chance
from sweeps.show.report import sweep_report
from sweeps.spec import SweepSpec
from sweeps.undecided import IN_FLOAT64, TOP, amplification
from tests.sweeps.drawn_rows import DATA

pytestmark = pytest.mark.once


def test_a_sweep_that_ranks_wrongly_is_put_right(
    drawn: SweepSpec,
    exact: Result,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    begin, first = crew.begin, int(exact.best(1)["row"][0])

    def unlucky(plan: Plan, start: int, end: int) -> Callable[[], Columns]:
        finish = begin(plan, start, end)

        def finished() -> Columns:
            columns = finish()
            if plan.canonical["precision"] == "float32":
                true = exact.take(columns["row"])
                error = 0.9 * METRICS["rms"].float32_error * amplification(plan, true.columns)
                luck = 1.0 + np.where(true["row"] == first, error, -error)
                columns["rms"] = (true["rms"] * luck[:, None, None]).astype(np.float32)
            return columns

        return finished

    monkeypatch.setattr(crew, "begin", unlucky)
    chance_alone = run(replace(drawn, goal=SweepGoal("rms", {"M_s": 5.0}, decide=0)), tmp_path / "alone")
    assert chance_alone.best(1)["row"][0] != first
    lines: list[str] = []
    found = run(drawn, tmp_path / "run", told=lines.append)
    assert found.best(TOP)["row"].tolist() == exact.best(TOP)["row"].tolist()
    best = found.best(1)
    np.testing.assert_array_equal(best["rms"], exact.best(1)["rms"])
    assert best[IN_FLOAT64].all()
    (sentence,) = chance(found)
    assert "rows that float32 cannot decide were run once more in float64: 0 ended otherwise" in sentence
    assert [line for line in lines if "rows that float32 cannot decide" in line] == lines != []
    sweep_report(found, tmp_path / "report.html", curves=False)
    assert sentence in (tmp_path / "report.html").read_text()
    assert command("sweep", "best", tmp_path / "run", "-n", 1) == 0
    said = capsys.readouterr().out
    assert sentence in said
    assert f"\n{first} " in said


def test_a_dry_run_says_that_rows_may_run_once_more(drawn: SweepSpec) -> None:
    assert "what float32 cannot decide, 1000 rows at most" in dry_run(drawn, make_plan(drawn), 2, measure=False)
    exact = replace(drawn, precision="float64")
    assert "cannot decide" not in dry_run(exact, make_plan(exact), 2, measure=False)


def test_it_resumes_and_has_one_hash(tmp_path: Path) -> None:
    sweep = {**DATA["sweep"], "rows": 24, "best": "peak_error", "constraints": {}}
    spec, folder = SweepSpec.from_dict({**DATA, "sweep": sweep}), tmp_path / "run"
    found = run(spec, folder)
    assert found.decided is not None
    loaded = Result.load(folder)
    assert (loaded.hash, loaded.complete) == (found.hash, True)
    (again,) = (folder / "float64").iterdir()
    assert len(found.decided.after["row"]) > 8
    parts = run(spec, tmp_path / "parts", chunk=8)
    assert len(list((tmp_path / "parts" / "float64" / again.name / "chunks").iterdir())) > 1
    assert parts.hash == found.hash
    # Interrupted between two chunks of the rows in float64.
    sorted((tmp_path / "parts" / "float64" / again.name / "chunks").iterdir())[0].unlink()
    assert not Result.load(tmp_path / "parts").complete
    assert run(spec, tmp_path / "parts").hash == found.hash
    # Another ranking leaves other rows undecided; those of the first stay.
    other = replace(spec, goal=SweepGoal("chatter", {}))
    changed = run(other, folder)
    assert changed.hash != found.hash
    assert Result.load(folder).hash == changed.hash
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    assert run(spec, folder).hash == found.hash
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")} == before


def test_what_takes_long_to_compile_is_readied_beside_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = DATA["sweep"] | {"rows": 40}
    spec = SweepSpec.from_dict(DATA | {"sweep": sweep})
    plain, readied = run(spec, tmp_path / "plain"), []
    module = importlib.import_module("sweeps.run")
    monkeypatch.setattr(module, "compiles_long", lambda: True)
    monkeypatch.setattr(module, "baseline", lambda plan: readied.append(plan) or baseline(plan))
    assert run(spec, tmp_path / "few").hash == plain.hash
    assert [plan.canonical["precision"] for plan in readied] == ["float32"]
    readied.clear()
    monkeypatch.setattr("sweeps.decided.MANY", 40)
    assert run(spec, tmp_path / "many").hash == plain.hash
    first, last = readied
    assert (first.canonical["precision"], len(first.rows)) == ("float64", 1)
    assert last.canonical["precision"] == "float32"
    readied.clear()
    assert plain.decided is not None
    run(spec, tmp_path / "many")
    assert not readied, "what has been run once more needs nothing"


def test_older_folders_and_stages_go_on_where_nothing_is_decided() -> None:
    refine = {"method": "pareto", "rounds": 1, "points": 4}
    for more, there in (({}, True), ({"decide": 0}, False), ({"precision": "float64"}, False)):
        spec = SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], **more}, "refine": refine})
        assert ("decide" in described(spec)[0]["goal"]) == there
