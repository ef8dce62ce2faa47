"""The real command, killed, stopped, starved of disk and doubled: the same bits come out."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

Write = Callable[[str], Path]
pytestmark = pytest.mark.slow


def start(path: Path, folder: Path, *more: str) -> "subprocess.Popen[str]":
    """A run in chunks so small that it takes a while; all runs of a test share compiled programs."""
    line = [sys.executable, "-m", "jaxmpc", "sweep", str(path), "-o", str(folder), "--chunk", "4", *more]
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    environment["JAX_COMPILATION_CACHE_DIR"] = str(path.parent / "compiled")
    environment["XDG_CACHE_HOME"] = str(path.parent / "cache")
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)


def finish(process: "subprocess.Popen[str]") -> str:
    """The hash that a run prints at its end."""
    said, _ = process.communicate(timeout=900)
    found = re.search(r"^result ([0-9a-f]{64})$", said, re.MULTILINE)
    assert found, said
    return found[1]


def chunks(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "chunks").glob("0*.npz")}


def until(condition: Callable[[], bool], seconds: float = 600.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def expected(write_spec: Write, spec_text: str, tmp_path: Path) -> tuple[Path, str]:
    """A spec, and the hash of its result in one go."""
    path = write_spec(spec_text)
    return path, finish(start(path, tmp_path / "at once"))


@pytest.fixture
def longer(write_spec: Write, spec_text: str, tmp_path: Path) -> tuple[Path, str]:
    """The same with 120 chunks, so that there is work left after every kill."""
    path = write_spec(spec_text.replace("points = 40", "points = 160"))
    return path, finish(start(path, tmp_path / "at once"))


def lost_by(process: "subprocess.Popen[str]", folder: Path) -> int:
    """Kill a process; how many chunks it had in hand that were not written."""
    # Stopped first: nobody takes over from who is alive while its leases are read.
    process.send_signal(signal.SIGSTOP)
    leases = [path for path in (folder / "leases").glob("0*.json") if f'"pid": {process.pid},' in path.read_text()]
    lost = [path for path in leases if not (folder / "chunks" / f"{path.stem}.npz").exists()]
    process.kill()
    process.communicate()
    return len(lost)


def test_two_parts_stand_eight_kills(longer: tuple[Path, str], tmp_path: Path) -> None:
    path, at_once = longer
    folder, choice, lost = tmp_path / "run", random.Random(5), []
    parts = [start(path, folder, "--part", f"{k}/2") for k in (1, 2)]
    # By progress, not by the clock: on a busy machine the other part would be done before a killed one is back.
    for moment in sorted(choice.sample(range(1, 80), 8)):
        until(lambda moment=moment: len(chunks(folder)) >= moment)
        time.sleep(choice.uniform(0.0, 0.1))
        victim = choice.randrange(2)
        assert parts[victim].poll() is None
        before = chunks(folder)
        lost.append(lost_by(parts[victim], folder))
        after = chunks(folder)
        assert {name: after[name] for name in before} == before
        parts[victim] = start(path, folder, "--part", f"{victim + 1}/2")
    assert [finish(part) for part in parts] == [at_once, at_once]
    assert max(lost) == 1, lost


def test_who_sleeps_past_its_lease_does_no_harm(expected: tuple[Path, str], tmp_path: Path) -> None:
    path, at_once = expected
    folder = tmp_path / "run"
    sleeper = start(path, folder, "--lease", "2")
    until(lambda: len(chunks(folder)) >= 3)
    sleeper.send_signal(signal.SIGSTOP)
    other = start(path, folder, "--lease", "2")
    assert finish(other) == at_once
    before = chunks(folder)
    sleeper.send_signal(signal.SIGCONT)
    assert finish(sleeper) == at_once
    assert chunks(folder) == before


def test_ctrl_c_finishes_the_round_and_keeps_it(expected: tuple[Path, str], tmp_path: Path) -> None:
    path, at_once = expected
    folder = tmp_path / "run"
    process = start(path, folder)
    until(lambda: len(chunks(folder)) >= 3)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "finishing the round" in said
    assert "run the same command again" in said
    assert list((folder / "leases").iterdir()) == []
    before = chunks(folder)
    assert finish(start(path, folder)) == at_once
    assert {name: when for name, when in chunks(folder).items() if name in before} == before


def test_kill_9_and_the_number_of_cores_change_no_bit(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    process = start(path, folder)
    while process.poll() is None and len(chunks(folder)) < 5:
        time.sleep(0.005)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    before = chunks(folder)
    assert finish(start(path, folder)) == finish(start(path, tmp_path / "at once", "--cores", "3"))
    assert {name: chunk for name, chunk in chunks(folder).items() if name in before} == before


def test_five_kills_at_any_moment_change_no_bit(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    at_once = finish(start(path, tmp_path / "at once", "--cores", "1"))
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


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KB."""
    folder = tmp_path / "tiny"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], check=False).returncode:
        pytest.skip("only root may mount")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_and_then_space(expected: tuple[Path, str], tiny_disk: Path) -> None:
    path, at_once = expected
    folder = tiny_disk / "run"
    process = start(path, folder)
    said, _ = process.communicate(timeout=200)
    assert process.returncode == 1, said
    assert "No space left on device" in said
    assert "Traceback" not in said
    assert [file.name for file in folder.rglob(".*")] == []
    subprocess.run(["mount", "-o", "remount,size=8m", str(tiny_disk)], check=True)
    assert finish(start(path, folder)) == at_once


def test_dask_workers_stand_kills_and_the_client_one(
    longer: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    # As on a machine so busy that no worker is back in time: Dask gives each of them up.
    monkeypatch.setenv("DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT", "100 ms")
    path, at_once = longer
    folder, choice = tmp_path / "run", random.Random(3)
    client = start(path, folder, "--local-workers", "2")
    # By progress: whoever kills starting workers by the clock kills the same chunk's thrice, which sets it aside.
    for kills, moment in enumerate(sorted(choice.sample(range(1, 80), 8))):
        until(lambda moment=moment: len(chunks(folder)) >= moment)
        time.sleep(choice.uniform(0.0, 0.3))
        assert client.poll() is None
        until(lambda client=client: bool(children(client.pid)))
        os.kill(choice.choice(children(client.pid)), signal.SIGKILL)
        if kills == 3:
            before = chunks(folder)
            # Two workers, each with a chunk in work and one to come.
            assert lost_by(client, folder) <= 4
            client = start(path, folder, "--local-workers", "2")
            until(lambda before=before: len(chunks(folder)) > len(before))
            assert {name: when for name, when in chunks(folder).items() if name in before} == before
    assert finish(client) == at_once


def children(parent: int) -> list[int]:
    """Processes of Dask's workers below a client: those that run Python's spawned main."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes()
                above = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if above == parent and b"spawn_main" in line:
                found.append(int(entry.name))
    return found
