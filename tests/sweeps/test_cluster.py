"""A scheduler and workers of the user's own, on the loopback interface: the same bits, little work done twice."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.sweeps.test_accidents import children, chunks, finish, start, until

pytestmark = pytest.mark.slow
distributed = pytest.importorskip("distributed")
Started = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Started]:
    """Starts `dask scheduler` or `dask worker` as the guide does."""
    started = []

    def begin(*line: str) -> "subprocess.Popen[bytes]":
        environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
        environment["JAX_COMPILATION_CACHE_DIR"] = str(tmp_path / "compiled")
        with (tmp_path / f"dask-{len(started)}.log").open("wb") as log:
            started.append(
                subprocess.Popen([sys.executable, "-m", "dask", *line], stdout=log, stderr=log, env=environment)
            )
        return started[-1]

    yield begin
    for process in reversed(started):
        process.terminate()
    for process in started:
        process.wait(60)


@pytest.fixture
def address(dask: Started, tmp_path: Path) -> str:
    """Of a scheduler."""
    file = tmp_path / "scheduler.json"
    dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    until(lambda: file.exists() and file.read_text().endswith("}"), 120.0)
    found: str = json.loads(file.read_text())["address"]
    return found


def finished(address: str) -> dict[str, int]:
    """How often the scheduler has seen each chunk finished."""

    def told(dask_scheduler: Any) -> list[str]:
        return [str(entry[0]) for entry in dask_scheduler.transition_log if entry[2] == "memory"]

    with distributed.Client(address, set_as_default=False) as client:
        names = client.run_on_scheduler(told)
    return {name: names.count(name) for name in names if name.startswith("worked")}


def test_a_scheduler_of_ones_own(
    dask: Started, address: str, write_spec: Callable[[str], Path], spec_text: str, tmp_path: Path
) -> None:
    path = write_spec(spec_text)
    at_once = finish(start(path, tmp_path / "at once"))
    workers = [dask("worker", address, "--nthreads", "1", "--death-timeout", "60", "--no-dashboard") for _ in "ab"]
    client = start(path, tmp_path / "run", "--cluster", address)
    for kills in range(2):
        until(lambda kills=kills: len(chunks(tmp_path / "run")) >= 4 + 8 * kills)
        (victim,) = children(workers[kills].pid)
        os.kill(victim, signal.SIGKILL)
    assert finish(client) == at_once
    # A worker has one thread, so one chunk in work; of those finished at most the one that was not yet fetched.
    times = finished(address)
    assert len(times) == len(chunks(tmp_path / "run"))
    assert sum(times.values()) - len(times) <= 2
