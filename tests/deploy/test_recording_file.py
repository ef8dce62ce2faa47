"""A recording is never lost and never silently missing."""

import contextlib
import errno
import fcntl
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from deploy.flight import recording_file
from deploy.flight.recorder import FlightRecorder
from deploy.flight.recording_file import RecordingFile
from jaxmpc.files.errors import InputError

DATA = bytes(range(256)) * 40
SIZE = 20_000


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where recordings go; other places where one may end lie apart from it."""
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "spare"))
    (tmp_path / "spare").mkdir()
    monkeypatch.chdir(tmp_path / "spare")
    return tmp_path / "flights"


def fail(monkeypatch, name, number, times=10**9):
    """Let a function of the system fail so many times."""
    left, right = [times], getattr(os, name)

    def failing(*arguments, **more):
        left[0] -= 1
        if left[0] >= 0:
            raise OSError(number, os.strerror(number))
        return right(*arguments, **more)

    monkeypatch.setattr(recording_file.os, name, failing)


def test_it_is_reserved_written_and_nothing_else_stays(folder):
    file = RecordingFile(folder, SIZE)
    (part,) = folder.iterdir()
    assert part.name == ".flight-0000.npz.part"
    assert part.stat().st_blocks * 512 >= SIZE
    saved = file.save(DATA)
    assert (saved.ok, saved.sentence) == (True, str(folder / "flight-0000.npz"))
    file.close()
    assert [path.name for path in folder.iterdir()] == ["flight-0000.npz"]
    assert file.path.read_bytes() == DATA
    assert file.path.stat().st_mode & 0o777 == 0o644


def test_who_opens_a_part_file_as_it_is_finished_takes_another(folder, monkeypatch):
    first, lock = RecordingFile(folder, SIZE), fcntl.flock

    def finished_first(descriptor, operation):
        monkeypatch.setattr(fcntl, "flock", lock)
        assert first.save(DATA).ok
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", finished_first)
    second = RecordingFile(folder, SIZE)
    assert second.save(b"other").ok
    assert (first.path.read_bytes(), second.path.read_bytes()) == (DATA, b"other")
    assert {path.name for path in folder.iterdir()} == {"flight-0000.npz", "flight-0001.npz"}


def test_what_is_not_needed_leaves_nothing_but_what_was_there(folder):
    RecordingFile(folder / "deeper", SIZE).close()
    assert not folder.exists()
    folder.mkdir()
    RecordingFile(folder, SIZE).close()
    assert list(folder.iterdir()) == []


def test_two_programs_do_not_take_each_others_and_a_killed_ones_is_taken_over(folder):
    one, other = RecordingFile(folder, SIZE), RecordingFile(folder, SIZE)
    assert (one.path.name, other.path.name) == ("flight-0000.npz", "flight-0001.npz")
    assert one.save(b"one").ok
    assert other.save(b"other").ok
    (folder / ".flight-0002.npz.part").write_bytes(bytes(10 * SIZE))
    third = RecordingFile(folder, SIZE)
    assert third.path.name == "flight-0002.npz"
    assert third.save(DATA).ok
    assert third.path.read_bytes() == DATA


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG])
@pytest.mark.parametrize("name", ["posix_fallocate", "open"])
def test_a_disk_that_is_full_or_read_only_at_the_start_is_refused(folder, monkeypatch, name, number):
    fail(monkeypatch, name, number)
    with pytest.raises(InputError) as refused:
        RecordingFile(folder, SIZE)
    assert "--output" in str(refused.value)
    assert os.strerror(number) in str(refused.value)
    monkeypatch.undo()
    assert not folder.exists()


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/flights", "/sys/flights"])
def test_where_no_folder_can_be_is_refused(tmp_path, place):
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(InputError, match="Choose another one"):
        RecordingFile(tmp_path / place, SIZE)
    assert (tmp_path / "file").read_bytes() == b"mine"


@pytest.mark.parametrize("mischief", ["gone", "moved", "emptied", "replaced"])
def test_a_folder_that_goes_meanwhile_is_made_again(folder, mischief):
    file = RecordingFile(folder, SIZE)
    if mischief == "moved":
        folder.rename(folder.with_name("elsewhere"))
    else:
        shutil.rmtree(folder)
    if mischief in ("emptied", "replaced"):
        folder.mkdir()
    if mischief == "replaced":
        (folder / ".flight-0000.npz.part").write_bytes(b"another's")
        (folder / "flight-0000.npz").write_bytes(b"another's")
    saved = file.save(DATA)
    file.close()
    assert saved.ok
    assert ("replaced" if mischief == "replaced" else "No such file") in saved.sentence
    written = Path(saved.sentence.partition(" (")[0])
    assert written.parent == folder
    assert written.read_bytes() == DATA
    if mischief == "replaced":
        assert (folder / "flight-0000.npz").read_bytes() == b"another's"
        assert (folder / ".flight-0000.npz.part").read_bytes() == b"another's"


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 KiB."""
    place = tmp_path / "small"
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)], capture_output=True)
    if done.returncode:
        pytest.skip("no file system can be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def fill(place):
    file = os.open(place / "fill", os.O_WRONLY | os.O_CREAT)
    with pytest.raises(OSError, match="No space left"):
        os.posix_fallocate(file, 0, 2**20)
    for size in (4096, 1):
        with contextlib.suppress(OSError):
            while os.write(file, bytes(size)):
                pass
    os.close(file)


def test_a_real_disk_that_is_full_is_refused_and_one_that_fills_up_meanwhile_does_no_harm(small_disk):
    file = RecordingFile(small_disk / "flights", SIZE)
    fill(small_disk)
    with pytest.raises(InputError, match="No space left"):
        RecordingFile(small_disk / "flights", SIZE)
    saved = file.save(DATA)
    assert (saved.ok, saved.sentence) == (True, str(small_disk / "flights" / "flight-0000.npz"))
    assert file.path.read_bytes() == DATA


def test_a_folder_that_becomes_a_file_sends_it_elsewhere_and_says_so(folder, tmp_path):
    file = RecordingFile(folder, SIZE)
    shutil.rmtree(folder)
    folder.write_bytes(b"a file")
    saved = file.save(DATA)
    assert not saved.ok
    assert (tmp_path / "spare" / "flight-0000.npz").read_bytes() == DATA
    assert str(tmp_path / "spare" / "flight-0000.npz") in saved.sentence


@pytest.mark.parametrize("name", ["pwrite", "fsync", "rename"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_disk_that_fails_while_it_is_written(folder, monkeypatch, name, number):
    file = RecordingFile(folder, SIZE)
    fail(monkeypatch, name, number, times=1)
    saved = file.save(DATA)
    assert saved.ok  # at the second attempt
    assert os.strerror(number) in saved.sentence
    assert (folder / "flight-0000.npz").read_bytes() == DATA
    file.close()
    assert [path.name for path in folder.iterdir()] == ["flight-0000.npz"]


def test_a_recording_that_can_be_written_nowhere_is_said_to_be_lost(folder, monkeypatch):
    file = RecordingFile(folder, SIZE)
    fail(monkeypatch, "fsync", errno.ENOSPC)
    saved = file.save(DATA)
    file.close()
    assert not saved.ok
    assert "LOST" in saved.sentence
    assert saved.sentence.count(os.strerror(errno.ENOSPC)) == 4


def test_the_reserve_is_as_large_as_the_largest_recording(folder):
    recorder = FlightRecorder(seconds=0.5)
    for k in range(600):
        recorder.append([float(k)] * recorder.width)
    header = {"artifact": "0" * 64, "reason": "x" * 200, "detail": "y" * 2000, "names": {"reason": ["z" * 20] * 60}}
    assert len(recorder.sealed(header)) <= FlightRecorder.largest(0.5, 1000.0)


def test_a_real_limit_of_the_system_is_refused_without_a_traceback(tmp_path):
    """RLIMIT_FSIZE: what a full disk or a quota does, by the kernel itself."""
    program = f"""
import resource, sys
from pathlib import Path
from deploy.flight.recording_file import RecordingFile
from jaxmpc.files.errors import InputError
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY))
try:
    RecordingFile(Path({str(tmp_path / "flights")!r}), {SIZE})
except InputError as error:
    sys.exit(str(error))
"""
    assert resource.RLIMIT_FSIZE is not None
    assert hasattr(signal, "SIGXFSZ")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("\n") == 1
    assert "File too large" in done.stderr
    assert not (tmp_path / "flights").exists()


def test_a_recording_that_somebody_else_has_put_there_meanwhile_is_not_written_over(folder):
    file = RecordingFile(folder, 1000)
    file.path.write_bytes(b"another")
    saved = file.save(b"ours")
    file.close()
    assert file.path.read_bytes() == b"another"
    assert sorted(each.read_bytes() for each in folder.iterdir()) == [b"another", b"ours"]
    assert saved.ok
