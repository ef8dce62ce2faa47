"""`jaxmpc run` with its recording in danger: never a traceback, never exit 0 without what was asked for."""

import errno
import os
import shutil
import tempfile

import pytest

from deploy.bus import candump
from deploy.cli import run as run_verb
from deploy.flight import recording_file
from deploy.flight.recorder import read
from deploy.loop.session import Session
from jaxmpc.cli import main

pytestmark = pytest.mark.once


@pytest.fixture
def fly(plain, tmp_path, capsys, monkeypatch):
    """Run against the twin; `meanwhile(folder)` is called when the arm has been let go."""
    from deploy.controller.file import to_bytes

    (tmp_path / "controller.npz").write_bytes(to_bytes(plain))
    (tmp_path / "spare").mkdir()
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "spare"))
    monkeypatch.chdir(tmp_path / "spare")

    def run(*flags, meanwhile=None):
        folder, flown = tmp_path / "flights", Session.run

        def disturbed(self, *arguments):
            ended = flown(self, *arguments)
            meanwhile(folder)
            return ended

        if meanwhile is not None:
            monkeypatch.setattr(Session, "run", disturbed)
        arguments = ["--lockstep", "--rhythm", "none", "--duration", "0.2", "--no-tare", "-o", str(folder), *flags]
        code = main(["run", str(tmp_path / "controller.npz"), *arguments])
        return code, capsys.readouterr(), folder

    return run


def remove(folder):
    shutil.rmtree(folder)


def replace(folder):
    shutil.rmtree(folder)
    folder.write_bytes(b"a file")


def test_what_cannot_be_recorded_is_not_flown(fly, tmp_path, monkeypatch):
    (tmp_path / "flights").write_bytes(b"a file")
    moved = []
    monkeypatch.setattr(Session, "__init__", lambda *arguments: moved.append(arguments))
    for flags in ((), ("--record",)):
        code, said, _ = fly(*flags)
        assert code == 2
        assert said.err.count("\n") == 1
        assert "--output" in said.err
    code, said, _ = fly("-o", "/proc/flights")
    assert (code, said.err.count("\n")) == (2, 1)
    monkeypatch.setattr(recording_file.os, "posix_fallocate", full)
    (tmp_path / "flights").unlink()
    code, said, folder = fly()
    assert code == 2
    assert "No space left" in said.err
    assert not folder.exists()
    assert moved == []


def full(*arguments, **more):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_folder_that_goes_in_flight_is_made_again(fly):
    code, said, folder = fly("--record", meanwhile=remove)
    assert code == 0
    (path,) = folder.iterdir()
    assert len(read(path).signals["time"]) > 500
    assert str(path) in said.out


def test_a_recording_that_ends_elsewhere_is_no_success(fly, tmp_path):
    code, said, _ = fly("--record", meanwhile=replace)
    assert code == 1
    (path,) = (tmp_path / "spare").iterdir()
    assert len(read(path).signals["time"]) > 500
    assert str(path) in said.out
    assert "ended: stopped, finished" in said.out
    assert "not where it was to be" in said.err


def test_a_recording_that_is_lost_is_no_success_and_says_so(fly, monkeypatch):
    monkeypatch.setattr(recording_file.os, "fsync", full)
    code, said, _ = fly("--record")
    assert code == 1
    assert "LOST" in said.out
    assert "No space left" in said.out


def test_who_did_not_ask_for_it_does_not_mind(fly):
    code, said, folder = fly(meanwhile=replace)
    assert code == 0
    assert folder.read_bytes() == b"a file"
    assert "flight recording" not in said.out


def test_a_bus_log_that_cannot_be_written_is_no_success(fly, tmp_path, monkeypatch):
    code, said, _ = fly("--bus-log", str(tmp_path / "nowhere" / "bus.log"))
    assert (code, said.err.count("\n")) == (2, 1)
    assert "--bus-log" in said.err
    if os.path.exists("/dev/full"):
        code, said, _ = fly("--bus-log", "/dev/full")
        assert (code, said.err.count("\n")) == (2, 1), "a device is no file"
        # A disk that fills while it flies.
        monkeypatch.setattr(run_verb, "check_file", lambda *_: None)
        code, said, _ = fly("--bus-log", "/dev/full")
        assert code == 1
        assert "writing failed: No space left" in said.out
    monkeypatch.setattr(candump, "CAPACITY", 16384)
    code, said, _ = fly("--bus-log", str(tmp_path / "bus.log"))
    assert code == 0


def test_a_fault_that_nobody_noticed_is_told_with_the_true_force_beside_the_measured(fly):
    code, said, _ = fly("--fault", "frames:duplicated=0.5@0.3", "--fault", "force:off@3000")
    assert code == 0
    (line,) = [line for line in said.out.splitlines() if line.startswith("largest push on the tissue: true")]
    true, measured = (float(part.split()[1]) for part in line.partition(": ")[2].split(", "))
    assert 0.2 < true < 2.0
    assert abs(true - measured) < 0.2
    told = [line for line in said.out.splitlines() if line.startswith("NOT NOTICED")]
    assert told == ["NOT NOTICED: fault frames:duplicated=0.5@0.3; the run ended as if there were none"]


def test_a_fault_that_ended_the_run_is_not_called_unnoticed(fly):
    code, said, _ = fly("--fault", "force:off@0.5")
    assert code == 1
    assert "largest force in any direction: true" in said.out
    assert "NOT NOTICED" not in said.out
