"""The same spec gives the same result, in whatever portions, order, devices and after whatever accident."""

import json
import os
import pickle
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import jax
import msgspec
import numpy as np
import pytest
import scipy.signal

from jaxmpc import design, evaluate
from jaxmpc.files.sealed import SEAL
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps import chunks as stored
from sweeps import cluster, rates, store
from sweeps.blocks import padded
from sweeps.compute import begin, compute
from sweeps.engines import Devices, devices
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan, make_plan
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec
from tests.jaxmpc.conftest import loop_matrices

ROWS = 120
Finished = tuple[Path, Result]


@pytest.fixture
def copy(finished: Finished, spec: SweepSpec, tmp_path: Path) -> Path:
    """A finished sweep in four chunks, to be damaged."""
    folder = tmp_path / "copy"
    assert run(spec, folder, chunk=32).hash == finished[1].hash
    return folder


def chunks(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in (folder / "chunks").glob("0*.npz")}


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


def test_no_bit_depends_on_the_chunk_size(finished: Finished, copy: Path) -> None:
    assert len(chunks(copy)) == 4
    assert Result.load(copy).hash == finished[1].hash


def test_no_bit_depends_on_the_order_of_rows(spec: SweepSpec) -> None:
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
    columns, _, rows, seconds = cluster.worked(make_plan(spec), 30, 85, None)
    for name, values in columns.items():
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


def test_a_finished_sweep_is_left_alone(copy: Path, spec: SweepSpec, finished: Finished) -> None:
    before, summary = chunks(copy), (copy / "result.json").stat().st_mtime_ns
    assert run(spec, copy, chunk=50).hash == finished[1].hash
    assert chunks(copy) == before
    assert (copy / "result.json").stat().st_mtime_ns == summary


def test_what_a_process_has_written_it_neither_reads_nor_hashes_again(
    copy: Path, spec: SweepSpec, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("000000032-000000064.npz", "000000064-000000096.npz"):
        (copy / "chunks" / name).unlink()
    (copy / "result.json").unlink()
    read, hash_of = Mock(wraps=stored._read_chunk), Mock(side_effect=make_plan(spec).hash_of)
    monkeypatch.setattr(stored, "_read_chunk", read)
    monkeypatch.setattr(Plan, "hash_of", hash_of)
    assert run(spec, copy, chunk=32).hash == finished[1].hash
    assert read.call_count == len(chunks(copy)) - 2
    assert hash_of.call_count == 1


@pytest.mark.parametrize("damage", ["flip", "cut", "other"])
def test_only_the_damaged_chunk_is_computed_again(
    damage: str, copy: Path, spec: SweepSpec, finished: Finished, caplog: pytest.LogCaptureFixture
) -> None:
    before = chunks(copy)
    victim = copy / "chunks" / "000000032-000000064.npz"
    data = bytearray(victim.read_bytes())
    if damage == "flip":
        data[random.Random(3).randrange(len(data))] ^= 1 << 5
    elif damage == "cut":
        del data[-SEAL - 7 :]
    else:
        data = bytearray((copy / "chunks" / "000000064-000000096.npz").read_bytes().replace(b"spec_hash", b"spec_hush"))
    victim.write_bytes(data)
    stored.read_chunks(copy, make_plan(spec))
    assert f"{victim.name} is left out, until the sweep is run again" in caplog.text
    assert victim.exists()
    assert run(spec, copy, chunk=32).hash == finished[1].hash
    assert f"{victim.name} is computed again" in caplog.text
    after = chunks(copy)
    assert {name for name in before if before[name][0] != after[name][0]} == {victim.name}
    assert after[victim.name][1] == before[victim.name][1]


def test_a_gap_is_filled_in_another_chunk_size(copy: Path, spec: SweepSpec, finished: Finished) -> None:
    (copy / "chunks" / "000000032-000000064.npz").unlink()
    (copy / "result.json").unlink()
    (copy / "chunks" / ".000000032-000000064.npz.left").write_bytes(b"half a chu")
    assert len(Result.load(copy)) == ROWS - 32
    assert not Result.load(copy).complete
    assert run(spec, copy, chunk=20).hash == finished[1].hash
    assert {"000000032-000000052.npz", "000000052-000000064.npz"} <= set(chunks(copy))


def test_a_folder_killed_before_its_first_chunk_goes_on(spec: SweepSpec, finished: Finished, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".manifest.json.left").write_bytes(b'{"schem')
    assert not store.check(folder, make_plan(spec))
    shutil.copy(finished[0] / "manifest.json", folder)
    assert run(spec, folder).hash == finished[1].hash


def test_another_environment_is_said(copy: Path, spec: SweepSpec, caplog: pytest.LogCaptureFixture) -> None:
    path = copy / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["environments"][0]["jaxlib"] = "0.0.1"
    path.write_text(json.dumps(manifest))
    run(spec, copy)
    assert 'jaxlib: there "0.0.1"' in caplog.text
    assert len(json.loads(path.read_text())["environments"]) == 2
    caplog.clear()
    run(spec, copy)
    assert caplog.text == ""


def test_folders_of_something_else_are_refused_untouched(
    copy: Path,
    write_spec: Callable[[str], Path],
    spec_text: str,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    other = write_spec(spec_text.replace("1900.0", "1800.0"))
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("\\documentclass")
    edited = tmp_path / "edited"
    shutil.copytree(copy, edited)
    manifest = json.loads((edited / "manifest.json").read_text())
    manifest["spec"]["experiment"]["duration"] = 2.0
    (edited / "manifest.json").write_text(json.dumps(manifest))
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*"))
    for folder, word in (
        (copy, "experiment.stiffness[1]: there 1900.0, here 1800.0"),
        (mine, "It holds other files"),
        (mine / "thesis.tex", "thesis.tex is a file"),
        (edited, "changed by hand"),
    ):
        assert command("sweep", other, "-o", folder) == 2
        assert word in capsys.readouterr().err
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*")) == before


def test_a_full_disk_stops_cleanly_and_costs_nothing(
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    finished: Finished,
) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, hard))
    try:
        code = command("sweep", path, "-o", folder, "--quiet")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 1
    assert "cannot write: File too large" in capsys.readouterr().err
    assert list((folder / "chunks").iterdir()) == []
    assert command("sweep", path, "-o", folder, "--quiet") == 0
    assert finished[1].hash in capsys.readouterr().out


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
    (environment,) = json.loads((tmp_path / "run" / "manifest.json").read_text())["environments"]
    assert environment["engine"] == "scan"


def test_rates_are_of_the_device_and_engine_that_will_run(spec: SweepSpec, tmp_path: Path) -> None:
    plan, file, pace = make_plan(spec), tmp_path / "rates.json", Pace(None, 256, 10_000)
    pace.tell(256, 9.0)
    pace.tell(256, 1.0)
    here = devices(2)
    rates.record(plan, pace, here, file)
    found = rates.estimate(plan, here, where=file)
    assert found is not None
    assert found.rate == 256.0
    for other in (Devices(1, "NVIDIA H100"), Devices(4, here.kind)):
        assert rates.estimate(plan, other, where=file) is None
    on_kernel = Plan(plan.canonical, plan.files, plan.goal, "kernel")
    assert pickle.loads(pickle.dumps(on_kernel)).engine == "kernel"
    assert on_kernel.spec_hash == plan.spec_hash
    assert rates.estimate(on_kernel, here, where=file) is None


def test_ctrl_c_keeps_what_is_finished(
    spec: SweepSpec,
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    finished: Finished,
) -> None:
    path, folder, write = write_spec(spec_text), tmp_path / "run", stored.write_chunk

    def interrupted(*arguments: Any) -> None:
        if len(chunks(folder)) == 2:
            raise KeyboardInterrupt
        write(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(stored, "write_chunk", interrupted)
        assert command("sweep", path, "-o", folder, "--chunk", 32, "--quiet") == 130
    assert "run the same command again" in capsys.readouterr().err
    assert len(chunks(folder)) == 2
    assert run(spec, folder, chunk=32).hash == finished[1].hash


def start(path: Path, folder: Path, cores: int = 2) -> "subprocess.Popen[str]":
    """The real command, in chunks so small that it takes a while; all starts of a test share compiled programs."""
    line = [sys.executable, "-m", "jaxmpc", "sweep", str(path), "-o", str(folder), "--chunk", "4"]
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    environment["JAX_COMPILATION_CACHE_DIR"] = str(path.parent / "compiled")
    line += ["--cores", str(cores)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)


def finish(process: "subprocess.Popen[str]") -> str:
    """The hash that a run prints at its end."""
    said, _ = process.communicate(timeout=300)
    found = re.search(r"^result ([0-9a-f]{64})$", said, re.MULTILINE)
    assert found, said
    return found[1]


@pytest.mark.slow
def test_kill_9_and_the_number_of_cores_change_no_bit(
    write_spec: Callable[[str], Path], spec_text: str, tmp_path: Path
) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    process = start(path, folder)
    while process.poll() is None and len(chunks(folder)) < 5:
        time.sleep(0.005)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    before = chunks(folder)
    assert finish(start(path, folder)) == finish(start(path, tmp_path / "at once", cores=3))
    assert {name: chunk for name, chunk in chunks(folder).items() if name in before} == before


@pytest.mark.slow
def test_five_kills_at_any_moment_change_no_bit(
    write_spec: Callable[[str], Path], spec_text: str, tmp_path: Path
) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    at_once = finish(start(path, tmp_path / "at once", cores=1))
    began = time.monotonic()
    assert finish(start(path, tmp_path / "again")) == at_once
    whole, choice, kills = time.monotonic() - began, random.Random(5), 0
    while kills < 5:
        process = start(path, folder)
        try:
            process.wait(choice.uniform(0.0, whole))
        except subprocess.TimeoutExpired:
            process.kill()
            kills += 1
        process.communicate()
    assert finish(start(path, folder)) == at_once
