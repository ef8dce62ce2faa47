"""Folders of refined sweeps: unfinished, interrupted, finished long ago."""

import os
import shutil
import signal
from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

import sweeps
from jaxmpc.cli.freeze import _chosen
from sweeps.chunks import chunk_files
from sweeps.crew import Alone, ComputedChunk, Stop
from sweeps.leases import Leases
from sweeps.pace import Pace
from sweeps.plan import Plan
from sweeps.refine.run import described
from sweeps.refine.run import run as refine
from sweeps.result import Result
from sweeps.run import run
from sweeps.share import Share
from sweeps.show.best_rows import chance, progress
from sweeps.spec import SweepSpec
from tests.sweeps.refined import DATA, STAGE, made

pytestmark = pytest.mark.once

OVER_MARGINS = """\
[experiment]
published = "table-1"
duration = 1.0
settle = 0.3
stiffness = [375.0, 1900.0]
reference = { z = -5.0 }
force_limit = 0.5

[params]
published = "cautious"

[sweep]
kind = "random"
rows = 20
decide = 0
axes = { lam = { log = [0.01, 1.0] }, T_cl = { log = [0.001, 0.01] } }

[refine]
method = "pareto"
goals = ["M_s", "gain_margin_db"]
rounds = 1
points = 5
"""
"""Every row passes its force limit, and has its margins."""


def unfinished(tmp_path: Path, spec: SweepSpec, chunks: dict[str, int]) -> tuple[Path, Result]:
    """A refined sweep in chunks of 10 rows as a kill leaves it: of each stage so many of its first chunks are gone."""
    folder = tmp_path / spec.refine.method if spec.refine else tmp_path
    found = refine(spec, folder, chunk=10)
    assert found.complete
    (folder / "result.json").unlink()
    for name, lost in chunks.items():
        (folder / "stages" / name / "result.json").unlink()
        for path in chunk_files(folder / "stages" / name)[:lost]:
            path.unlink()
    return folder, found


def test_a_halving_without_its_last_stage_is_unfinished(
    tmp_path: Path, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, found = unfinished(tmp_path, made(method="halving", stages=[STAGE]), {"1-full": 2})
    begun = sweeps.load(folder)
    assert (begun.complete, [name for name, _ in begun.stages]) == (False, ["0-screen"]), "a stage without a row"
    capsys.readouterr()
    row = int(begun.best(1)["row"][0])
    for words in (["best"], ["pareto"], ["row", row], ["sensitivity"]):
        assert command("sweep", words[0], folder, *words[1:]) == 0
        assert capsys.readouterr().err == "jaxmpc sweep: unfinished: 100 of 100 rows of stage 0-screen\n"
    chosen, _ = _chosen(Namespace(params=folder, row=row, experiment=None))
    assert chosen.to_dict() == begun.controller(begun.place(row)).to_dict()
    assert capsys.readouterr().err == "jaxmpc freeze: unfinished sweep: 100 of 100 rows of stage 0-screen\n"
    shutil.rmtree(folder / "stages" / "1-full")
    assert not sweeps.load(folder).complete
    again = refine(made(method="halving", stages=[STAGE]), folder)
    assert (again.hash, again.complete) == (found.hash, True)


def test_a_row_around_a_front_has_its_number_from_the_beginning(tmp_path: Path) -> None:
    spec = made(method="pareto", rounds=2, points=20, seed=5)
    folder, found = unfinished(tmp_path, spec, {"1-around": 1})
    begun = sweeps.load(folder)
    assert not begun.complete
    assert (len(begun), len(begun.plan.rows)) == (len(found) - 10, len(found))
    assert progress(begun) == f"{len(found) - 10} of {len(found)} rows up to stage 2-around"
    assert begun["row"].tolist() == [*range(100), *range(110, len(found))]
    for name in begun.columns:
        np.testing.assert_array_equal(begun[name], found[name][begun["row"]], err_msg=name)
    assert begun.plan.spec_hash == found.plan.spec_hash
    assert refine(spec, folder).hash == found.hash
    (folder / "result.json").unlink()
    assert not sweeps.load(folder).complete, "a round may be missing"


def test_what_is_finished_stays_whatever_a_front_would_be_today(
    tmp_path: Path,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Rows that fail stood on fronts of margins once, and what came of that is not to be computed anew."""
    path, folder = write_spec(OVER_MARGINS), tmp_path / "run"
    with pytest.MonkeyPatch.context() as patch:
        # As it was then: a row counted whatever its status.
        patch.setattr(Result, "ok", property(lambda result: np.ones(len(result), bool)))
        assert command("sweep", path, "-o", folder, "--quiet") == 0
    found = sweeps.load(folder)
    assert found.complete
    first = found.stages[0][1]
    assert not first.pareto("M_s", "gain_margin_db")["row"].tolist(), "no row is OK"
    files = {file: file.stat().st_mtime_ns for file in folder.rglob("*") if file.is_file()}
    capsys.readouterr()
    assert command("sweep", path, "-o", folder, "--quiet") == 0
    assert f"result {found.hash}" in capsys.readouterr().out
    assert {file: file.stat().st_mtime_ns for file in folder.rglob("*") if file.is_file()} == files


class Interrupted(Alone):
    """Ctrl-C once a stretch is computed."""

    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        for piece in super().work(plan, share, leases, pace, stop):
            if not stop():
                os.kill(os.getpid(), signal.SIGINT)
            yield piece


def test_ctrl_c_in_the_last_round_of_a_stage_leaves_what_comes_after_it(tmp_path: Path) -> None:
    refined, folder = made(method="pareto", rounds=1, points=20, seed=5), tmp_path / "run"
    spec = replace(refined, goal=msgspec.structs.replace(refined.goal, decide=100))
    lines: list[str] = []
    stopped = refine(spec, folder, gentle=True, crew=Interrupted, told=lines.append)
    assert [line.partition(":")[0] for line in lines] == ["0-full"]
    assert not stopped.complete
    for result in (stopped, sweeps.load(folder)):
        ((name, stage),) = result.stages
        assert (name, len(stage), stage.complete) == ("0-full", 100, False)
        assert stage.decided is not None
        assert progress(stage) == f"100 of 100 rows, 0 of {len(stage.decided.plan.rows)} in float64"
        assert not [line for line in chance(result) if "once more" in line]
    plain = replace(spec, refine=None, goal=refined.goal)
    assert run(plain, tmp_path / "plain", gentle=True, crew=Interrupted).complete, "there was nothing left to do"
    begun = refine(refined, tmp_path / "other", gentle=True, crew=Interrupted)
    assert ([name for name, _ in begun.stages], begun.complete) == (["0-full"], False)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


class InterruptedAround(Alone):
    """Ctrl-C once the rows around a front are computed, none of which has run once more."""

    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        for piece in super().work(plan, share, leases, pace, stop):
            if plan.space.kind == "grid":
                os.kill(os.getpid(), signal.SIGINT)
            yield piece


def test_ctrl_c_in_a_round_around_a_front_is_no_error(tmp_path: Path) -> None:
    """Of the first stage float64's rows had a column that those of the second lacked: it ended in a traceback."""
    refined, folder = made(method="pareto", rounds=1, points=20, seed=5), tmp_path / "run"
    spec = replace(refined, goal=msgspec.structs.replace(refined.goal, decide=100))
    stopped = refine(spec, folder, gentle=True, crew=InterruptedAround)
    assert [(name, stage.complete) for name, stage in stopped.stages] == [("0-full", True), ("1-around", False)]
    assert stopped.decided is not None
    assert 0 < len(stopped.decided.after["row"]) < len(stopped.decided.plan.rows)
    assert stopped.decided.after.keys() == sweeps.load(folder).decided.after.keys() == stopped.columns.keys()
    assert refine(spec, folder).complete


def test_rounds_tell_together_what_float64_decided(tmp_path: Path) -> None:
    refined = made(method="pareto", rounds=1, points=20, seed=5)
    found = refine(replace(refined, goal=msgspec.structs.replace(refined.goal, decide=100)), tmp_path / "run")
    parts = [stage.decided for _, stage in found.stages if stage.decided is not None]
    assert found.decided is not None
    assert found.complete
    counts = [len(part.plan.rows) for part in parts]
    assert (len(found.decided.plan.rows), len(counts)) == (sum(counts), 2)
    assert len(found.decided.after["row"]) == found["in_float64"].sum()
    said = chance(found)
    assert said[0].startswith(f"{sum(counts)} rows that float32 cannot decide were run once more in float64: ")
    places = found["in_float64"]
    np.testing.assert_array_equal(found.decided.after["lam"], found["lam"][places])
    np.testing.assert_array_equal(found.decided.after["rms"], found["rms"][places])
    assert found.plan.goal.decide == 100
    undecided = replace(found, columns={**found.columns, "in_float64": np.zeros(len(found), bool)})
    assert "each round ran in float64" in chance(undecided)[1]
    assert "`decide` in [sweep] bounds" in chance(replace(undecided, stages=()))[1]


def test_a_recording_of_a_stage_lies_beside_the_spec_and_counts_by_its_content(tmp_path: Path) -> None:
    """It was looked for where the command ran, and the hash knew its name alone."""
    hashes = []
    for name, file, size in (("a", "x.csv", 1e-5), ("b", "y.csv", 1e-5), ("c", "x.csv", 2e-5)):
        folder = tmp_path / name
        folder.mkdir()
        rows = "".join(f"{0.01 * t},0,0,{size * t}\n" for t in range(201))
        (folder / file).write_text(f"t,x,y,z\n{rows}")
        changed = {"best": 1, "experiment": {"motion": {"kind": "recording", "file": file}}}
        hashes.append(described(SweepSpec.from_dict({**DATA, "refine": {"rerun": changed}}, folder))[1])
    assert hashes[0] == hashes[1] != hashes[2]
