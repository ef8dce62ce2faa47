"""Two jobs that begin within seconds in one folder: the second is refused, and replaces nothing of the first."""

import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from jaxmpc import Experiment, InputError, Params
from jaxmpc.files import alone
from jaxmpc.files.alone import alone_in
from tuning import TuneSpec, pareto, trials, tune
from tuning.trials import HARD, Job


@pytest.fixture
def held(tmp_path: Path) -> Iterator[Path]:
    """A folder in which another process is at work; another descriptor is locked out as one is."""
    descriptor = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    yield tmp_path
    os.close(descriptor)


JOBS: dict[str, Callable[[TuneSpec, Path], Any]] = {
    "tune": lambda spec, folder: tune(spec, folder),
    "front": lambda spec, folder: pareto(spec, folder),
    "trials": lambda spec, folder: trials.run(
        Job((Params(),), Experiment.published("table-1-wam"), HARD, 0), 1, folder
    ),
}


@pytest.mark.parametrize("job", JOBS.values(), ids=JOBS)
def test_the_folder_of_a_running_job_is_left_alone(
    held: Path,
    job: Callable[[TuneSpec, Path], Any],
    small: Callable[..., dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def begun(*_: Any, **__: Any) -> None:
        raise AssertionError("began beside another")

    monkeypatch.setattr("tuning.run_search", begun)
    monkeypatch.setattr("tuning.search.front.run_search", begun)
    monkeypatch.setattr(trials, "outcomes_of", begun)
    with pytest.raises(InputError, match="Another job is at work there"):
        job(TuneSpec.from_dict(small(pareto={"M_s": [2.0, 3.0]})), held)
    assert [*held.iterdir()] == []


def test_a_folder_is_free_again_and_one_that_cannot_be_locked_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = tmp_path / "a" / "b"
    with alone_in(new), pytest.raises(InputError), alone_in(new):
        pass
    with alone_in(new), alone_in(None):
        assert new.is_dir()
    (new / "file").touch()
    for taken in (new / "file", new / "file" / "within"):
        with pytest.raises(InputError, match="must be a folder"), alone_in(taken):
            pass

    def unable(*_: Any) -> None:
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr(alone.fcntl, "flock", unable)
    with alone_in(new), alone_in(new):
        pass
