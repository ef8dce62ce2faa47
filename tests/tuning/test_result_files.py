"""Files of a result: whole, found from anywhere, and with the command that freezes it."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import tuning.reports.files
from jaxmpc import Experiment, Params
from jaxmpc.world.heart.motion import Motion
from tuning import TuneResult, TuneSpec
from tuning.proof.flyable import freeze_command
from tuning.reports.explained import Study
from tuning.reports.files import tuned_on, write
from tuning.reports.page import html_report

Job = Callable[..., dict[str, Any]]


def done(found: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(found)
    return future


def test_the_command_in_the_file_freezes_what_was_tuned_on_what_it_was_tuned_on(small: Job) -> None:
    arm = TuneSpec.from_dict(
        small(
            experiment={"published": "table-1-wam", "arm": {"compensation": 0.7}, "stiffness": [300.0, 3000.0]},
            goals={"ideal": False, "M_s": 1.9, "gain_margin_db": 6.0205999, "delay_margin_s": 1.5e-3},
        )
    )
    words = freeze_command(arm, "experiment.toml").split()
    assert words[:5] == ["jaxmpc", "freeze", "params.toml", "--experiment", "experiment.toml"]
    promised = ["--max-ms", "1.9", "--min-delay-ms", "1.5", "--min-gain-db", "6.0205999"]
    assert words[5:-2] == promised, "no digit less: it could be refused for the last"
    assert Experiment.from_dict(tuned_on(arm.experiment)) == arm.experiment
    ideal = TuneSpec.from_dict(small(goals={"ideal": True, "gain_margin_db": 6.0}))
    assert freeze_command(ideal, "table-1").split()[5:-2] == ["--ideal", "--max-ms", "2", "--min-gain-db", "6"]


def test_a_recording_that_was_tuned_on_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.savetxt("heart.csv", np.zeros((2000, 3)), delimiter=",")
    experiment = Experiment(motion=Motion(kind="recording", file="heart.csv"))
    assert tuned_on(experiment)["motion"]["file"] == str(tmp_path / "heart.csv")


def test_files_are_whole_and_the_page_needs_nothing_else(result: TuneResult, study: Study, tmp_path: Path) -> None:
    write(result, done(study), tmp_path, done(None))
    texts = {"params.toml", "experiment.toml", "history.npz", "report.txt", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == texts | {"before_after.png"}
    assert Params.from_toml(tmp_path / "params.toml").lam.shape == (16,)
    assert (tmp_path / "before_after.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == html_report(result, study)


def test_what_was_found_is_kept_where_explaining_it_fails(result: TuneResult, tmp_path: Path) -> None:
    failed: Future[Study] = Future()
    failed.set_exception(MemoryError())
    with pytest.raises(MemoryError):
        write(result, failed, tmp_path, done(None))
    assert (tmp_path / "params.toml").exists()
    assert (tmp_path / "report.txt").exists()


def test_a_controller_stands_beside_what_it_was_tuned_on_or_nowhere(
    result: TuneResult, study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed between two files."""
    written: list[str] = []

    def killed(path: Path, *rest: Any) -> None:
        if written:
            raise KeyboardInterrupt
        written.append(path.name)
        path.touch()

    monkeypatch.setattr(tuning.reports.files, "write_toml", killed)
    named = msgspec.structs.replace(result.spec, experiment=Experiment.published("table-1"))
    with pytest.raises(KeyboardInterrupt):
        write(replace(result, spec=named), done(study), tmp_path, done(None))
    assert written == ["experiment.toml"]
    assert not (tmp_path / "params.toml").exists()
