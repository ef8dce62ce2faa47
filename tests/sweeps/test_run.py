"""The same spec gives the same rows, in whatever portions, order and devices: those of scipy and of `evaluate`."""

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import msgspec
import numpy as np
import pytest
import scipy.signal

from jaxmpc import design, evaluate
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps import cluster
from sweeps.blocks import padded
from sweeps.chunks import chunk_files
from sweeps.compute import begin, compute
from sweeps.environments import noted
from sweeps.plan import Columns, Plan, make_plan
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec
from tests.jaxmpc.conftest import loop_matrices

ROWS = 120
Finished = tuple[Path, Result]


def test_what_is_read_back_is_what_was_computed(finished: Finished) -> None:
    folder, result = finished
    loaded = Result.load(folder)
    assert (len(loaded), loaded.complete, loaded.hash) == (ROWS, True, result.hash)
    assert loaded.baseline == result.baseline
    assert json.loads((folder / "result.json").read_text())["result_hash"] == result.hash


def test_the_hash_sees_every_column(finished: Finished) -> None:
    _, result = finished
    for name in result.plan.layout:
        columns = {key: values.copy() for key, values in result.columns.items()}
        columns[name].reshape(-1).view(np.uint8)[-1] ^= 1
        assert Result(result.plan, columns).hash != result.hash


@pytest.mark.oracle
def test_no_bit_depends_on_the_order_of_rows(spec: SweepSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor on how many blocks of a device are asked for at a time: here two and one."""
    monkeypatch.setattr("jaxmpc.xla.blocks.BLOCK", 32)
    plan = make_plan(spec)
    straight = compute(plan, 0, ROWS)
    for first, last in ((70, 71), (3, 40), (110, ROWS)):
        for name, values in compute(plan, first, last).items():
            np.testing.assert_array_equal(values, straight[name][first:last], err_msg=name)


def test_rows_can_be_computed_by_whoever_is_asked(finished: Finished, spec: SweepSpec) -> None:
    task = pickle.loads(pickle.dumps(partial(compute, make_plan(spec), 30, 40)))
    for name, values in task().items():
        np.testing.assert_array_equal(values, finished[1][name][30:40], err_msg=name)


def test_a_worker_computes_a_chunk_round_by_round(
    finished: Finished, spec: SweepSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def counted(plan: Plan, first: int, last: int) -> Callable[[], Columns]:
        asked.append(last - first)
        return begin(plan, first, last)

    monkeypatch.setattr(cluster, "_prepared", True)
    monkeypatch.setattr(cluster, "_compiled", set())
    monkeypatch.setattr("sweeps.crew.round_of", lambda plan: 20)
    monkeypatch.setattr("sweeps.crew.begin", counted)
    (chunk,), _, rows, seconds = cluster.worked(make_plan(spec), 30, 85, None)
    assert chunk.columns is not None
    for name, values in chunk.columns.items():
        np.testing.assert_array_equal(values, finished[1][name][30:85], err_msg=name)
    # A chunk at once would be a program of its own for each length; the first round has compiled, and says nothing.
    assert asked == [20, 20, 15]
    assert rows == padded(make_plan(spec), jax.local_device_count(), 50, 85) * 2
    assert seconds > 0.0


@pytest.fixture
def smooth(spec: SweepSpec) -> SweepSpec:
    """Without quantisation: it makes float32 and float64 runs that are nearly unstable drift apart (3 % in RMS)."""
    sensor = msgspec.structs.replace(spec.experiment.sensor, lsb=(0.0, 0.0, 0.0))
    return replace(spec, experiment=msgspec.structs.replace(spec.experiment, sensor=sensor))


def test_residuals_of_rows_are_scipys(smooth: SweepSpec, tmp_path: Path) -> None:
    result, experiment = run(smooth, tmp_path / "run"), smooth.experiment
    signals, settle = experiment.signals, round(experiment.settle / experiment.sampling_time)
    cutoff, compared = experiment.loop_path().sensor_cutoff, 0
    for row in range(0, ROWS, 20):
        params = result.controller(row)
        gains = jax.tree.map(np.asarray, design(params))
        for cell, K_s in enumerate(experiment.stiffness):
            if result["status"][row, cell] != Status.OK:
                continue
            ideal = experiment.damping == "ideal"
            loop = loop_matrices(gains, K_s, float(params.K2), experiment.delay, ideal, cutoff)
            for axis in range(3):
                inputs = np.column_stack([signals.heart[:, axis], signals.noise[:, axis], signals.force_ref[:, axis]])
                _, force, _ = scipy.signal.dlsim((*loop, experiment.sampling_time), inputs)
                error = force[settle:, 0] - signals.force_ref[settle:, axis]
                # 1000 float32 steps of the slowest loops lose three of seven digits.
                assert result["rms"][row, cell, axis] == pytest.approx(np.sqrt(np.mean(error**2)), rel=5e-4)
            compared += 1
    assert compared > 6


@pytest.mark.oracle
def test_rows_are_those_of_evaluate(smooth: SweepSpec, tmp_path: Path) -> None:
    result = run(smooth, tmp_path / "run")
    exact = evaluate(Params.stack([result.controller(place) for place in range(ROWS)]), smooth.experiment)
    np.testing.assert_array_equal(result["status"], exact.status)
    ok = result["status"] == Status.OK
    assert 0 < ok.sum() < ok.size
    # A sweep of the linear loop does not ask how the force swings.
    assert np.isnan(result["swing"]).all()
    for name in {*METRICS, *MARGINS} - {"swing"}:
        expected = np.asarray(getattr(exact.metrics if name in METRICS else exact.margins, name))
        # Margins are float64 on both sides; 1000 float32 steps of the slowest loops lose three of seven digits.
        tolerance = 5e-4 if name in METRICS else 1e-9
        np.testing.assert_allclose(result[name][ok], expected[ok], rtol=tolerance, err_msg=name)
        if name in METRICS:
            # A run beyond its force limit is finite, and says by how much.
            assert np.isnan(result[name][~ok & (result["status"] != Status.FORCE_LIMIT)]).all()


def test_a_dry_run_writes_nothing(
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    assert command("sweep", write_spec(spec_text), "--dry-run", "--chunk", 50) == 0
    said = capsys.readouterr().out
    for words in (
        "rows        120 (120 more with Hu > Hp are left out)",
        "linear on",
        "1 program\n",
        "7.2e+05",
        "nothing was written",
    ):
        assert words in said
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]


def test_a_dry_run_says_what_is_there(
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    finished: Finished,
    tmp_path: Path,
) -> None:
    def said(text: str = spec_text) -> str:
        before = sorted((tmp_path / "run").rglob("*"))
        assert command("sweep", write_spec(text), "-o", tmp_path / "run", "--dry-run") == 0
        assert sorted((tmp_path / "run").rglob("*")) == before
        return capsys.readouterr().out

    assert "  there " not in said()
    shutil.copytree(finished[0], tmp_path / "run")
    assert "  there       all of it: the sweep is finished, and nothing is left to compute\n" in said()
    other = spec_text.replace("[sweep]", '[sweep]\nbest = "chatter"', 1)
    assert "  there       every row; what float32 cannot decide of this ranking is left\n" in said(other)
    for chunk in chunk_files(tmp_path / "run"):
        chunk.unlink()
    assert "  there       0 of 120 rows\n" in said()


def test_an_engine_is_named_on_the_command_line_and_in_the_environment(
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    finished: Finished,
    tmp_path: Path,
) -> None:
    path = write_spec(spec_text)
    for engine, why in (("kernel", "needs a gpu"), ("mjx", "linear")):
        assert command("sweep", path, "-o", tmp_path / "run", "--engine", engine) == 2
        assert why in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert command("sweep", path, "-o", tmp_path / "run", "--engine", "scan", "--quiet") == 0
    assert finished[1].hash in capsys.readouterr().out
    (environment,) = noted(tmp_path / "run")
    assert environment["engine"] == "scan"
