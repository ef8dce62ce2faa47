"""The command line: exit codes, one sentence for wrong input, nothing written then; freeze end to end."""

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deploy.controller.file import load
from deploy.controller.golden import replay
from jaxmpc import Experiment, Params
from jaxmpc.cli import VERBS, main
from jaxmpc.files.toml import write_toml
from tests.sources import ROOT

TUNED = {"K2": 100.0, "Khat_s": 970.0, "Q_p": 9.0, "T_cl": 2e-4}


def params_file(folder: Path, text: str) -> str:
    (folder / "p.toml").write_text(text)
    return str(folder / "p.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[params]\nlamda = 1.0", ["p.toml:2", "lamda", "Did you mean 'lam'"]),
        ("[params]\nlam = nan", ["p.toml:2", "lam = nan", "[1e-12, 1e+12]"]),
        ("[params]\nHp = 10\nHu = 12", ["p.toml:3", "Hu = 12", "[1, Hp (= 10)]", "raise Hp"]),
        ("[params]\nHp = 65", ["p.toml:2", "Hp = 65", "[1, 64]"]),
        ("[params]\nHp = 10.5", ["p.toml:2", "Hp = 10.5", "whole number"]),
        ("[params]\nT_cl = 0.0", ["p.toml:2", "T_cl = 0.0"]),
        ("[params]\nKhat_s = -5.0", ["p.toml:2", "Khat_s = -5.0"]),
        ('[params]\nQ_p = "big"', ["p.toml:2", "Q_p = big", "a number"]),
        ("[params]\nK2 = [1.0, 2.0]", ["p.toml:2", "K2", "one number"]),
        ("[params]\ndelta = 0.0", ["p.toml:2", "delta", "positive somewhere"]),
        ('[params]\narchitecture = "pid"', ["p.toml:2", "pid", "mpc-aob"]),
        ("[params]\nlam = 1.0\nlam = 2.0", ["p.toml:3", "Cannot overwrite"]),
        ("[parms]\nlam = 1.0", ["p.toml:1", "parms", "Did you mean 'params'"]),
        ("lam = [", ["p.toml", "valid TOML"]),
    ],
)
def test_wrong_parameters_exit_2_with_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: list[str]
) -> None:
    path, output = params_file(tmp_path, text), tmp_path / "c.npz"
    assert main(["freeze", path, "-o", str(output)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    for word in [*words, "must be"]:
        assert word in told
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "table-2"], ["table-2", "figure-3", "table-1"]),
        (["simulate", "family"], ["family is a controller (for --params)", "table-1-wam"]),
        (["simulate", "table-1", "--video"], ["--video", "--physics wam"]),
        (["simulate", "table-1-wam", "--video", "film.avi"], ["film.avi", "film.mp4"]),
        (["simulate", "gone.toml"], ["gone.toml", "No such file"]),
        (["simulate", "table-1", "--params", "bogus"], ["bogus", "text, printed"]),
        (["freeze", "text"], ["M_s at 375", "at most 2"]),
        (["freeze", "cautious", "-o", "x.txt"], ["-o = x.txt", "ending in .npz"]),
        (["freeze", "printed"], ["spectral radius", "below 1"]),
    ],
)
def test_wrong_arguments_exit_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    told = capsys.readouterr().err
    for word in words:
        assert word in told
    assert list(tmp_path.iterdir()) == []


def test_no_traceback_from_a_process_either(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "jaxmpc", "freeze", params_file(tmp_path, "[params]\nlam = -1.0")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_short_closed_loop_time_is_allowed(tmp_path: Path) -> None:
    """T_cl below the sampling time is useful: a nearly dead-beat reference."""
    assert float(Params.from_toml(params_file(tmp_path, "[params]\nT_cl = 0.0001")).T_cl) == 1e-4


@pytest.mark.oracle
def test_frozen_controller_is_the_simulated_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_toml(tmp_path / "p.toml", {"params": TUNED})
    output = tmp_path / "c.npz"
    assert main(["freeze", str(tmp_path / "p.toml"), "-o", str(output), "--ideal"]) == 0
    artifact = load(output)
    assert replay(artifact)[0] < 1e-9
    stiffnesses = [row["stiffness"] for row in artifact.margins]
    assert len(stiffnesses) >= 33
    assert set(Experiment.published("table-1").stiffness) <= set(stiffnesses)
    assert max(row["M_s"] for row in artifact.margins) <= 2.0
    assert main(["check", str(output)]) == 0
    assert "intact" in capsys.readouterr().out


def test_every_verb_has_help(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in VERBS:
        with pytest.raises(SystemExit) as stopped:
            main([verb, "--help"])
        assert stopped.value.code == 0
        out = capsys.readouterr().out
        assert "usage: jaxmpc" in out
        assert "?." not in out


def test_a_key_that_is_no_letter_is_one_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a terminal's bytes are held to UTF-8, one that is none would end the thread that listens for Enter."""
    keys = io.TextIOWrapper(io.BytesIO(b"\xe9\n\n"), encoding="utf-8", errors="strict")
    monkeypatch.setattr(sys, "stdin", keys)
    assert main(["list"]) == 0
    assert list(keys) == ["\ufffd\n", "\n"]


def test_xla_is_silenced_before_a_verb_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    """`tune` and `trials` import JAX with their package, and it reads the level only then."""
    levels = []

    def look(name: str) -> Any:
        levels.append(os.environ.get("TF_CPP_MIN_LOG_LEVEL"))
        raise KeyboardInterrupt

    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    monkeypatch.setattr("jaxmpc.cli.import_module", look)
    assert main(["trials", "text"]) == 130
    assert levels == ["3"]


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_who_closes_the_outputs_loses_words_alone(closed: str) -> None:
    command = ["bash", "-c", f'"$@" {closed}', "-", sys.executable, "-m", "jaxmpc"]
    for words, code in (["list"], 0), (["lst"], 2):
        ran = subprocess.run([*command, *words], cwd=ROOT, capture_output=True, text=True, check=False)
        assert ran.returncode == code
        assert "Traceback" not in ran.stdout + ran.stderr
