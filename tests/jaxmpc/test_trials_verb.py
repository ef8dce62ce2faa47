"""`jaxmpc trials`: exit codes, files, and what it says, on outcomes made by hand."""

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.beside import Apart
from jaxmpc.cli import main
from tuning import trials
from tuning.trials import Job, Outcomes, drawn
from tuning.trials import outcomes as judging
from tuning.trials.cli import _drawing


@pytest.fixture
def peaks(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Largest |e| per trial of the first and the second controller [N]; runs nothing."""
    largest = {"first": 0.5, "second": 3.0}

    def outcomes_of(job: Job, firsts: Sequence[int]) -> Iterator[Outcomes]:
        for first in firsts:
            flat = np.zeros((drawn.BLOCK, len(job.controllers)))
            peak = np.broadcast_to(np.array(list(largest.values()))[: len(job.controllers), None], (*flat.shape, 3))
            # In the first trial alone.
            peak = np.where(np.arange(first, first + drawn.BLOCK)[:, None, None] == 0, peak, 0.1)
            calm, never, rms = 0.01 * peak, flat == 1.0, 0.1 * peak
            when = flat + np.nan, flat + 0.9, flat + np.inf
            yield Outcomes(flat.astype(np.int8), *when, rms, rms, peak, calm, never)

    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda: None)
    monkeypatch.setattr(trials, "outcomes_of", outcomes_of)
    return largest


@pytest.mark.slow
def test_who_never_fails_ends_with_0(
    peaks: dict[str, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "tuned.toml").write_text("[params]\nK2 = 20.0")
    # Named by what the user wrote.
    command = ["trials", str(tmp_path / "tuned.toml"), "--against", "text", "--trials", "40", "--hard"]
    out = tmp_path / "out"
    assert main([*command, "-o", str(out)]) == 0
    said, told = capsys.readouterr()
    tuned = tmp_path / "tuned.toml"
    assert f"trial: both 0, only {tuned} 0, only text 0, neither 40" in said
    assert told.startswith("trial 0: text left 2 N, |e| 3.00 N; ")
    assert "stress arms" in said
    assert re.findall(r"left \|e\| < 2 N\W+(\d+)", said) == ["0", "1"]
    assert {path.name for path in out.iterdir()} == {
        "blocks",
        "trials.csv",
        "trials.html",
        "worst.toml",
        "worst-against.toml",
    }
    with (out / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    assert [(row["text: lost"], row["text: left 2 N"]) for row in rows[:2]] == [("0", "1"), ("0", "0")]
    assert float(rows[0]["stiffness [N/m]"]) == pytest.approx(Experiment.from_toml(out / "worst.toml").stiffness[0])
    files = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    assert main([*command, "-o", str(out)]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == files
    capsys.readouterr()
    assert main([*command, "--seed", "1", "-o", str(out)]) == 2
    assert "very trials" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == files


@pytest.mark.slow
def test_who_is_lost_ends_with_1_and_the_count(
    peaks: dict[str, float], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    peaks["first"] = 2.5
    monkeypatch.setattr(judging, "SWINGING", 0.02)
    assert main(["trials", "text", "--trials", "3"]) == 1
    told = capsys.readouterr()
    assert "text was lost in 1 of 3 trials" in told.err
    assert "M_s presliding" in told.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bogus"], "bogus"),
        (["text", "--against", "bogus"], "bogus"),
        (["text", "--experiment", "table-1"], "physics"),
        (["text", "--trials", "0"], "trials = 0"),
        (["text", "--seed", "-1"], "seed = -1"),
    ],
)
@pytest.mark.usefixtures("peaks")
def test_wrong_input_ends_with_2_and_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["trials", *arguments, "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("peaks")
def test_a_file_is_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").touch()
    assert main(["trials", "text", "--trials", "1", "-o", str(tmp_path / "out")]) == 2
    assert "a folder" in capsys.readouterr().err


@pytest.mark.oracle
def test_beside_a_gpu_another_process_draws_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxmpc.terminal.process.may_have_a_gpu", lambda: True)
    job = Job((Params(),), Experiment.published("table-1-wam"))
    with _drawing(job, 30) as drawing:
        assert isinstance(drawing, Apart)
        for one, other in zip(drawing.result(), job.drawn(0, 30), strict=True):
            np.testing.assert_array_equal(one, other)
