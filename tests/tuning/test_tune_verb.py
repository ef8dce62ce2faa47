"""`jaxmpc tune`: files, exit codes, and what it says."""

import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import Params, evaluate, margins
from jaxmpc.cli import main
from jaxmpc.files.sealed import unseal
from jaxmpc.files.toml import write_toml
from tuning import TuneSpec
from tuning.job.scenarios import scenarios
from tuning.objective.comparison import compare

Job = Callable[..., dict[str, Any]]


@pytest.fixture(autouse=True)
def _one_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda: None)


def verb(folder: Path, job: dict[str, Any]) -> int:
    write_toml(folder / "tune.toml", job)
    return main(["tune", str(folder / "tune.toml"), "-o", str(folder / "out"), "--quiet"])


@pytest.mark.slow
def test_a_tuned_controller_comes_with_its_proof(
    small: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = small(goals={"M_s": 6.0})
    assert verb(tmp_path, job) == 0
    out = tmp_path / "out"
    said = capsys.readouterr().out
    for path in out.iterdir():
        assert f"wrote {path}" in said
    assert {path.name for path in out.iterdir()} == {
        "params.toml",
        "experiment.toml",
        "history.npz",
        "report.txt",
        "report.html",
        "state.npz",
        "history.png",
        "before_after.png",
    }
    params = Params.from_toml(out / "params.toml")
    spec = TuneSpec.from_dict(job)
    origin = tomllib.loads((out / "params.toml").read_text())["provenance"]
    assert origin["spec_sha256"] == spec.digest
    assert origin["heldout_seeds"] == [1000, 1001]
    runs = compare([spec.params, params], scenarios(spec.experiment, spec.scenarios, (1000, 1001)))
    assert origin["heldout_worst_rms_after"] == pytest.approx(runs.rms[1].max(), rel=1e-12)
    found = margins(params, spec.judged_at, ideal=True)
    np.testing.assert_allclose(origin["M_s_ideal"], found.M_s, rtol=1e-12)
    header, arrays = unseal((out / "history.npz").read_bytes())
    assert arrays["linear/values"].shape == (11, 8, len(header["names"]))

    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert verb(tmp_path, job) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before

    assert verb(tmp_path, small(goals={"M_s": 5.0})) == 2
    assert "very spec" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.slow
def test_goals_that_nobody_meets_end_with_a_sentence(
    small: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stale = tmp_path / "out" / "params.toml"
    stale.parent.mkdir()
    stale.write_text("[params]\n")
    (stale.parent / "notes.txt").write_text("of somebody else")
    assert verb(tmp_path, small(goals={"M_s": 1.01}, tune={"steps": 3})) == 1
    said = capsys.readouterr()
    assert "M_s ≤ 1.01 is missed by" in said.err
    assert "N/m" in said.err
    assert f"wrote {stale.parent / 'report.html'}" in said.out
    assert "notes.txt" not in said.out
    assert not (tmp_path / "out" / "params.toml").exists()


def test_a_wrong_spec_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verb(tmp_path, {"goals": {"Ms": 2.0}}) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'tune.toml'}:2: goals.Ms = 2.0" in said
    assert not (tmp_path / "out").exists()


def test_the_folder_of_a_sweep_is_left_alone(small: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sweep and a job of one name go to one folder unless told otherwise."""
    manifest = tmp_path / "out" / "manifest.json"
    manifest.parent.mkdir()
    manifest.write_text("{}")
    assert verb(tmp_path, small()) == 2
    assert "a folder without a sweep" in capsys.readouterr().err
    assert list(manifest.parent.iterdir()) == [manifest]


@pytest.mark.slow
def test_comparison_is_that_of_the_public_functions(spec: TuneSpec) -> None:
    unstable = Params(Khat_s=200.0)
    runs = compare([spec.params, unstable], scenarios(spec.experiment, spec.scenarios, (1000, 1001)))
    expected = evaluate(spec.params, spec.experiment.with_seed(1001)).metrics.rms
    np.testing.assert_allclose(runs.rms[0, 1], expected, rtol=1e-9)
    assert np.isnan(runs.rms[1, :, -1]).all()


@pytest.mark.slow
def test_kill_minus_nine_and_again(small: Job, tmp_path: Path) -> None:
    job = small(tune={"steps": 150, "duration": 12.0})
    files = []
    for kills in (0, 2):
        folder = tmp_path / str(kills)
        folder.mkdir()
        write_toml(folder / "tune.toml", job)
        command = [sys.executable, "-m", "jaxmpc", "tune", str(folder / "tune.toml"), "-o", str(folder / "out")]
        for _ in range(kills):
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
                state = folder / "out" / "state.npz"
                seen = state.stat().st_mtime_ns if state.exists() else 0
                while process.poll() is None and (not state.exists() or state.stat().st_mtime_ns == seen):
                    time.sleep(0.05)
                process.send_signal(signal.SIGKILL)
            assert process.returncode == -signal.SIGKILL
        subprocess.run(command, check=True, capture_output=True)
        files.append({name: (folder / "out" / name).read_bytes() for name in ("params.toml", "history.npz")})
    assert files[0] == files[1]
