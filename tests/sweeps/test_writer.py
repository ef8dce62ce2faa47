"""Writing beside computing: in order, one thing at a time, and nothing that goes wrong is lost."""

import threading
from pathlib import Path
from typing import Any

import pytest

from sweeps import chunks, crew
from sweeps.leases import given_up
from sweeps.plan import Plan
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec
from sweeps.writer import Writer


def full() -> None:
    raise OSError(28, "No space left on device")


def test_what_goes_wrong_comes_out_at_the_next_call_or_at_the_end() -> None:
    done: list[int] = []
    with Writer() as writer:
        writer.begin(lambda: done.append(1))
        writer.begin(full)
        with pytest.raises(OSError, match="No space"):
            writer.begin(lambda: done.append(2))
        writer.begin(full)
        with pytest.raises(OSError, match="No space"):
            writer.settle()
        writer.begin(lambda: done.append(3))
    assert done == [1, 3]
    last = Writer()
    last.begin(full)
    with pytest.raises(OSError, match="No space"), last:
        pass


def test_what_is_begun_is_done_whatever_stops_the_rest() -> None:
    done, going, writer = [], threading.Event(), Writer()

    def slow() -> None:
        assert going.wait(10.0)
        done.append(1)

    writer.begin(slow)
    assert not writer.failed
    going.set()
    with pytest.raises(KeyboardInterrupt), writer:
        raise KeyboardInterrupt
    assert done == [1]


@pytest.fixture
def in_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds of 16 rows and files of 32 at most: the third stretch is what is left, 88 rows in three files."""
    monkeypatch.setattr(Plan, "largest_chunk", 32)
    monkeypatch.setattr(crew, "round_of", lambda plan: 16)
    monkeypatch.setattr("sweeps.run.round_of", lambda plan: 16)


STRETCHES = [(0, 16), (16, 32), (32, 64), (64, 96), (96, 120)]


def files(folder: Path) -> list[Any]:
    return [chunks.stretch_of(path.name) for path in chunks.chunk_files(folder)]


@pytest.mark.usefixtures("in_files")
def test_a_file_is_written_while_rows_of_the_next_are_computed(
    spec: SweepSpec, finished: tuple[Path, Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begun, following, write, begin = [], threading.Event(), chunks.write_chunk, crew.begin
    leases: list[int] = []

    def asked(plan: Any, first: int, last: int) -> Any:
        begun.append(first)
        leases.append(len(list((tmp_path / "run" / "leases").glob("0*.json"))))
        if first == 96:
            following.set()
        return begin(plan, first, last)

    def late(folder: Path, plan: Any, first: int, *rest: Any) -> None:
        assert first != 32 or following.wait(60.0), "the next file was not begun meanwhile"
        write(folder, plan, first, *rest)

    monkeypatch.setattr(crew, "begin", asked)
    monkeypatch.setattr(chunks, "write_chunk", late)
    assert run(spec, tmp_path / "run").hash == finished[1].hash
    assert files(tmp_path / "run") == STRETCHES
    assert begun == [0, 16, 32, 48, 64, 80, 96, 112]
    # A kill costs one stretch: no other is taken before it is on the disk.
    assert set(leases) == {1}


@pytest.mark.usefixtures("in_files")
def test_files_beside_rows_that_fail_are_kept(
    spec: SweepSpec, finished: tuple[Path, Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begin = crew.begin

    def wrong(plan: Any, first: int, last: int) -> Any:
        if first == 80:
            raise ArithmeticError("a gain of 0/0")
        return begin(plan, first, last)

    with monkeypatch.context() as patch:
        patch.setattr(crew, "begin", wrong)
        assert len(run(spec, tmp_path / "run")) == 104
    assert files(tmp_path / "run") == [*STRETCHES[:3], (64, 80), (96, 120)]
    assert list(given_up(tmp_path / "run")) == [(80, 96)]
    assert run(spec, tmp_path / "run", retry=True).hash == finished[1].hash


@pytest.mark.usefixtures("in_files")
def test_a_full_disk_ends_it_and_gives_everything_back(
    spec: SweepSpec, finished: tuple[Path, Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    write = chunks.write_chunk

    def filled(folder: Path, plan: Any, first: int, *rest: Any) -> None:
        if first >= 64:
            full()
        write(folder, plan, first, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(chunks, "write_chunk", filled)
        with pytest.raises(OSError, match="No space"):
            run(spec, tmp_path / "run")
    assert files(tmp_path / "run") == STRETCHES[:3]
    assert list((tmp_path / "run" / "leases").iterdir()) == []
    assert run(spec, tmp_path / "run").hash == finished[1].hash
