"""Who works on what: leases are exclusive, end with their owners, and keep count of the dead."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.sealed import SealError
from sweeps import store
from sweeps.chunks import chunk_files, chunk_name, read_chunks
from sweeps.cluster import worked
from sweeps.compute import begin
from sweeps.leases import MOST_DEATHS, Leases, given_up
from sweeps.plan import make_plan
from sweeps.result import Result
from sweeps.run import SweepStoppedError, run
from sweeps.share import Share
from sweeps.spec import SweepSpec

pytestmark = pytest.mark.once

Make = Callable[..., Leases]


@pytest.fixture
def leases(tmp_path: Path) -> Iterator[Make]:
    made: list[Leases] = []

    def make(silence: float = 60.0) -> Leases:
        made.append(Leases(tmp_path, silence))
        return made[-1]

    yield make
    for each in made:
        each.close()


def dead_owner(folder: Path, stretch: tuple[int, int], warm: bool = True, deaths: int = 0, early: int = 0) -> Path:
    """The lease of a process of this machine that is gone."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    machine = Path("/proc/sys/kernel/random/boot_id").read_text().strip() + os.readlink("/proc/self/ns/pid")
    lease = {"owner": "x", "machine": machine, "pid": gone.pid, "warm": warm, "deaths": deaths, "early": early}
    path = folder / "leases" / f"{chunk_name(*stretch)}.json"
    path.write_text(json.dumps(lease))
    return path


def test_a_stretch_belongs_to_one(leases: Make) -> None:
    one, other = leases(), leases()
    assert one.take((0, 10))
    assert not other.take((0, 10))
    # Of another length, as another rate makes it.
    assert not other.take((5, 25))
    assert other.others() == [(0, 10)]
    assert one.others() == []
    one.release((0, 10))
    assert other.take((5, 25))


def test_a_silent_owner_loses_it_by_the_clock_of_the_folder(leases: Make, tmp_path: Path) -> None:
    one, other = leases(), leases(silence=5.0)
    assert one.take((0, 10))
    path = tmp_path / "leases" / "000000000-000000010.json"
    # On another machine, whose processes cannot be seen from here.
    path.write_text(path.read_text().replace(str(json.loads(path.read_text())["machine"]), "elsewhere"))
    assert not other.take((0, 10))
    hour_ago = time.time() - 3600.0
    os.utime(path, (hour_ago, hour_ago))
    assert other.take((0, 10))
    # Waking up, the first one does not give back what is no longer its own.
    one.release((0, 10))
    assert path.exists()


def test_a_dead_owner_of_this_machine_is_seen_at_once(leases: Make, tmp_path: Path) -> None:
    mine = leases()
    dead_owner(tmp_path, (0, 10))
    assert mine.others() == []
    assert mine.take((0, 10))
    assert json.loads((tmp_path / "leases" / "000000000-000000010.json").read_text())["deaths"] == 1


@pytest.mark.parametrize("changed", [{"pid": "7"}, {"pid": 10**30}, {"pid": 0}, {"pid": None}, {"deaths": "two"}])
def test_a_lease_that_no_process_wrote_ends_by_its_age(leases: Make, tmp_path: Path, changed: dict[str, Any]) -> None:
    mine = leases()
    path = dead_owner(tmp_path, (0, 10))
    path.write_text(json.dumps({**json.loads(path.read_text()), **changed}))
    assert not mine.take((0, 10))
    os.utime(path, (0.0, 0.0))
    assert mine.take((0, 10))


@pytest.mark.parametrize(("warm", "deaths", "early", "lost"), [(True, MOST_DEATHS - 1, 0, True), (False, 2, 5, False)])
def test_what_keeps_killing_is_set_aside(
    warm: bool, deaths: int, early: int, lost: bool, leases: Make, tmp_path: Path
) -> None:
    mine = leases()
    dead_owner(tmp_path, (0, 10), warm, deaths, early)
    assert mine.take((0, 10)) is not lost
    assert list(given_up(tmp_path)) == [(0, 10)] * lost
    mine.retry()
    assert given_up(tmp_path) == {}


def test_work_is_shared_without_gaps_or_overlap(spec: SweepSpec, leases: Make, tmp_path: Path) -> None:
    plan = make_plan(spec)
    (tmp_path / "chunks").mkdir()
    nothing = np.zeros(len(plan.rows), bool)
    hands = [Share(tmp_path, plan, nothing, leases(), (k, 2)) for k in (1, 2)]
    taken = []
    while True:
        found = [hand.next(7 + 4 * i) for i, hand in enumerate(hands)]
        if found == [None, None]:
            break
        taken += [stretch for stretch in found if stretch is not None]
    assert hands[0].finished() is False
    assert sorted(row for first, last in taken for row in range(first, last)) == list(range(len(plan.rows)))
    # Each begins with its own half.
    assert {stretch[0] for stretch in taken[:2]} == {0, len(plan.rows) // 2}


def failing(at: int, fetched: bool) -> Any:
    """`begin` that raises, or whose result cannot be fetched."""

    def raising() -> Any:
        raise ArithmeticError("a gain of 0/0")

    def wrong(plan: Any, first: int, last: int) -> Any:
        if first <= at < last:
            return raising if fetched else raising()
        return begin(plan, first, last)

    return wrong


@pytest.mark.parametrize(("part", "begin"), [((1, 3), 0), ((2, 3), 40), ((3, 3), 80), ((1, 1), 0)])
def test_a_part_begins_where_its_rows_do(part: tuple[int, int], begin: int, leases: Make, tmp_path: Path) -> None:
    plan: Any = SimpleNamespace(bounds=np.array([120]))
    share = Share(tmp_path, plan, np.zeros(120, bool), leases(), part)
    assert share.next(30) == (begin, begin + 30)


def test_a_stretch_ends_with_a_world_if_it_holds_the_end_of_one(leases: Make, tmp_path: Path) -> None:
    plan: Any = SimpleNamespace(bounds=np.array([25, 30, 75, 120]))
    share = Share(tmp_path, plan, np.zeros(120, bool), leases(), (1, 1))
    assert [share.next(40) for _ in range(4)] == [(0, 30), (30, 70), (70, 75), (75, 115)]


def test_two_processes_may_put_one_damaged_chunk_away(
    spec: SweepSpec, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plan = make_plan(spec)
    store.prepare(tmp_path / "run", plan)
    path = tmp_path / "run" / "chunks" / "000000000-000000120.npz"
    path.write_bytes(b"PK")

    def other_first(*given: Any) -> Any:
        monkeypatch.undo()
        read_chunks(tmp_path / "run", plan, mend=True)
        raise SealError("cut short")

    monkeypatch.setattr("sweeps.chunks._read_chunk", other_first)
    assert not read_chunks(tmp_path / "run", plan, mend=True).there.any()
    assert [file.name for file in path.parent.iterdir()] == [f"{path.name}.damaged"]


@pytest.mark.parametrize("fetched", [False, True])
def test_a_chunk_that_fails_is_set_aside_and_can_be_tried_again(
    fetched: bool, spec: SweepSpec, finished: tuple[Path, Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("sweeps.crew.begin", failing(40, fetched))
        part = run(spec, tmp_path / "run", chunk=32)
        assert (len(part), part.complete) == (120 - 32, False)
        ((stretch, reason),) = given_up(tmp_path / "run").items()
        assert (stretch, reason) == ((32, 64), "ArithmeticError: a gain of 0/0")
        patch.undo()
        assert not run(spec, tmp_path / "run").complete
        patch.setattr("sweeps.crew.begin", failing(40, fetched))
        with pytest.raises(SweepStoppedError, match=r"rows .* could not be computed: ArithmeticError"):
            run(SweepSpec(**{**vars(spec), "on_error": "stop"}), tmp_path / "run", chunk=32, retry=True)
    # What stopped it has set nothing aside.
    assert run(spec, tmp_path / "run").hash == finished[1].hash
    assert list((tmp_path / "run" / "leases").iterdir()) == []


@pytest.mark.parametrize("fetched", [False, True])
@pytest.mark.parametrize("at", [0, 40, 119])
def test_a_round_that_fails_costs_no_other(
    at: int,
    fetched: bool,
    spec: SweepSpec,
    finished: tuple[Path, Result],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    folder, (first, last) = tmp_path / "run", (at // 32 * 32, min(at // 32 * 32 + 32, 120))
    with monkeypatch.context() as patch:
        patch.setattr("sweeps.cluster._prepared", True)
        patch.setattr("sweeps.crew.round_of", lambda plan: 32)
        patch.setattr("sweeps.crew.begin", failing(at, fetched))
        part = run(spec, folder, chunk=120)
        (piece,) = [piece for piece in worked(make_plan(spec), 0, 120, None)[0] if piece.columns is None]
    assert (piece.first, piece.last) == (first, last)
    assert given_up(folder) == {(first, last): "ArithmeticError: a gain of 0/0"}
    assert part["row"].tolist() == [row for i, row in enumerate(part.plan.rows.tolist()) if not first <= i < last]
    assert list((folder / "leases").iterdir()) == []
    assert run(spec, folder, retry=True).hash == finished[1].hash


def test_every_flipped_bit_costs_its_chunk_alone(
    spec: SweepSpec, finished: tuple[Path, Result], tmp_path: Path
) -> None:
    folder, plan = tmp_path / "run", make_plan(spec)
    run(spec, folder, chunk=40)
    path = folder / "chunks" / "000000040-000000080.npz"
    good = path.read_bytes()
    random = np.random.default_rng(7)
    for place in random.integers(0, 8 * len(good), 400):
        bad = bytearray(good)
        bad[place // 8] ^= 1 << (place % 8)
        path.write_bytes(bad)
        there = read_chunks(folder, plan).there
        assert np.flatnonzero(~there).tolist() == list(range(40, 80))
    others = {each: each.stat().st_mtime_ns for each in chunk_files(folder) if each != path}
    assert run(spec, folder, chunk=40).hash == finished[1].hash
    assert path.read_bytes() == good
    assert {each: each.stat().st_mtime_ns for each in others} == others
