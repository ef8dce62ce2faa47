"""A sweep goes on from what lies in its folder, whole or damaged, and computes nothing twice."""

import errno
import json
import os
import random
import resource
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from jaxmpc.files.errors import InputError, UnreadableError
from jaxmpc.files.sealed import SEAL
from sweeps import chunks as stored
from sweeps import store
from sweeps.environments import noted
from sweeps.goal import SweepGoal
from sweeps.machine import processor
from sweeps.plan import Plan, make_plan
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec

pytestmark = pytest.mark.once

ROWS = 120
Finished = tuple[Path, Result]


@pytest.fixture
def copy(finished: Finished, spec: SweepSpec, tmp_path: Path) -> Path:
    """A finished sweep in four chunks, to be damaged."""
    folder = tmp_path / "copy"
    assert run(spec, folder, chunk=32).hash == finished[1].hash
    return folder


def chunks(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in (folder / "chunks").glob("0*.npz")}


def test_no_bit_depends_on_the_chunk_size(finished: Finished, copy: Path) -> None:
    assert len(chunks(copy)) == 4
    assert Result.load(copy).hash == finished[1].hash


def test_a_finished_sweep_is_left_alone(copy: Path, spec: SweepSpec, finished: Finished) -> None:
    before, summary = chunks(copy), (copy / "result.json").stat().st_mtime_ns
    assert run(spec, copy, chunk=50).hash == finished[1].hash
    assert chunks(copy) == before
    assert (copy / "result.json").stat().st_mtime_ns == summary


def test_what_a_process_has_written_it_neither_reads_nor_hashes_again(
    copy: Path, spec: SweepSpec, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("000000032-000000064.npz", "000000064-000000096.npz"):
        (copy / "chunks" / name).unlink()
    (copy / "result.json").unlink()
    read, hash_of = Mock(wraps=stored._read_chunk), Mock(side_effect=make_plan(spec).hash_of)
    monkeypatch.setattr(stored, "_read_chunk", read)
    monkeypatch.setattr(Plan, "hash_of", hash_of)
    assert run(spec, copy, chunk=32).hash == finished[1].hash
    assert read.call_count == len(chunks(copy)) - 2
    assert hash_of.call_count == 1


@pytest.mark.parametrize("damage", ["flip", "cut", "other"])
def test_only_the_damaged_chunk_is_computed_again(
    damage: str, copy: Path, spec: SweepSpec, finished: Finished, caplog: pytest.LogCaptureFixture
) -> None:
    before = chunks(copy)
    victim = copy / "chunks" / "000000032-000000064.npz"
    data = bytearray(victim.read_bytes())
    if damage == "flip":
        data[random.Random(3).randrange(len(data))] ^= 1 << 5
    elif damage == "cut":
        del data[-SEAL - 7 :]
    else:
        data = bytearray((copy / "chunks" / "000000064-000000096.npz").read_bytes().replace(b"spec_hash", b"spec_hush"))
    victim.write_bytes(data)
    stored.read_chunks(copy, make_plan(spec))
    assert f"{victim.name} is left out, until the sweep is run again" in caplog.text
    assert victim.exists()
    assert run(spec, copy, chunk=32).hash == finished[1].hash
    assert f"{victim.name} is computed again" in caplog.text
    after = chunks(copy)
    assert {name for name in before if before[name][0] != after[name][0]} == {victim.name}
    assert after[victim.name][1] == before[victim.name][1]


@pytest.mark.parametrize("reason", [errno.EACCES, errno.EIO, errno.ESTALE])
def test_a_chunk_that_may_not_be_read_is_no_damaged_one(
    reason: int, copy: Path, spec: SweepSpec, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was set aside as damaged and computed again; a share that is mounted again has it whole."""
    before, victim = chunks(copy), copy / "chunks" / "000000032-000000064.npz"
    opened = os.open

    def refused(path: Any, *how: Any, **more: Any) -> int:
        if str(path) == str(victim):
            raise OSError(reason, os.strerror(reason), str(path))
        return opened(path, *how, **more)

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(InputError, match=rf"{victim.name} = .*{os.strerror(reason)}\. It may be whole") as told:
        run(spec, copy, chunk=32)
    assert isinstance(told.value, UnreadableError)
    assert len(Result.load(copy)) == ROWS - 32
    assert f"{victim.name} is left out: It cannot be read: {os.strerror(reason)}" in caplog.text
    monkeypatch.undo()
    assert chunks(copy) == before


def test_a_chunk_in_the_place_of_another_is_put_away(
    copy: Path, spec: SweepSpec, finished: Finished, caplog: pytest.LogCaptureFixture
) -> None:
    """As a copy under a wrong name leaves it: the rows that belong there were computed in every run and never kept."""
    before, folder = chunks(copy), copy / "chunks"
    shutil.copy(folder / "000000000-000000032.npz", folder / "000000032-000000064.npz")
    assert len(Result.load(copy)) == ROWS - 32
    assert run(spec, copy, chunk=32).hash == finished[1].hash
    assert "it holds rows 0 … 31, others than its name says" in caplog.text
    assert {name: data for name, (_, data) in chunks(copy).items()} == {
        name: data for name, (_, data) in before.items()
    }
    assert Result.load(copy).complete


def test_a_gap_is_filled_in_another_chunk_size(copy: Path, spec: SweepSpec, finished: Finished) -> None:
    (copy / "chunks" / "000000032-000000064.npz").unlink()
    (copy / "result.json").unlink()
    (copy / "chunks" / ".000000032-000000064.npz.left").write_bytes(b"half a chu")
    assert len(Result.load(copy)) == ROWS - 32
    assert not Result.load(copy).complete
    assert run(spec, copy, chunk=20).hash == finished[1].hash
    assert {"000000032-000000052.npz", "000000052-000000064.npz"} <= set(chunks(copy))


def test_a_folder_killed_before_its_first_chunk_goes_on(spec: SweepSpec, finished: Finished, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".manifest.json.left").write_bytes(b'{"schem')
    assert not store.check(folder, make_plan(spec))
    shutil.copy(finished[0] / "manifest.json", folder)
    assert run(spec, folder).hash == finished[1].hash


def test_another_environment_is_said(copy: Path, spec: SweepSpec, caplog: pytest.LogCaptureFixture) -> None:
    (path,) = (copy / "environments").iterdir()
    path.write_text(json.dumps({**json.loads(path.read_text()), "jaxlib": "0.0.1"}))
    path.rename(path.with_name("000000000001.json"))
    run(spec, copy)
    assert 'jaxlib: there "0.0.1"' in caplog.text
    assert len(noted(copy)) == 2
    caplog.clear()
    run(spec, copy)
    assert caplog.text == ""


def test_environments_in_a_manifest_from_before_count(
    copy: Path, spec: SweepSpec, caplog: pytest.LogCaptureFixture
) -> None:
    path, (here,) = copy / "manifest.json", noted(copy)
    manifest = json.loads(path.read_text())
    shutil.rmtree(copy / "environments")
    path.write_text(json.dumps({**manifest, "environments": [here]}))
    run(spec, copy)
    assert (caplog.text, noted(copy)) == ("", [here])
    path.write_text(json.dumps({**manifest, "environments": [{**here, "jaxlib": "0.0.1"}]}))
    run(spec, copy)
    assert 'jaxlib: there "0.0.1"' in caplog.text
    assert noted(copy) == [{**here, "jaxlib": "0.0.1"}, here]
    # How rows are ranked is written anew, and who computed stays.
    run(replace(spec, goal=SweepGoal("true_rms", decide=0)), copy)
    assert noted(copy) == [{**here, "jaxlib": "0.0.1"}, here]
    path.write_text(json.dumps({**manifest, "environments": 3}))
    with pytest.raises(InputError, match="environments = 3: must be a list"):
        noted(copy)


def test_two_hosts_that_begin_at_once_are_both_noted(
    spec: SweepSpec, finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, write, hosts = tmp_path / "run", store.write_first, ["another processor"]

    def overtaken(path: Path, data: bytes) -> bool:
        if hosts:
            # The other host does all of its work between this one's look at the folder and its manifest.
            other = hosts.pop()
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("sweeps.machine.processor", lambda: other)
                assert run(spec, folder).hash == finished[1].hash
        return write(path, data)

    monkeypatch.setattr(store, "write_first", overtaken)
    assert run(spec, folder).hash == finished[1].hash
    assert [each["cpu"] for each in noted(folder)] == ["another processor", processor()]


def test_folders_of_something_else_are_refused_untouched(
    copy: Path,
    write_spec: Callable[[str], Path],
    spec_text: str,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    other = write_spec(spec_text.replace("1900.0", "1800.0"))
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("\\documentclass")
    edited = tmp_path / "edited"
    shutil.copytree(copy, edited)
    manifest = json.loads((edited / "manifest.json").read_text())
    manifest["spec"]["experiment"]["duration"] = 2.0
    (edited / "manifest.json").write_text(json.dumps(manifest))
    refined = tmp_path / "refined"
    store.prepare_refined(refined, {}, "0")
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*"))
    for folder, word in (
        (copy, "experiment.stiffness[1]: there 1900.0, here 1800.0"),
        (mine, "It holds other files"),
        (mine / "thesis.tex", "thesis.tex is a file"),
        (edited, "changed by hand"),
        (refined, "must be empty or of a plain sweep. It holds a refined one: choose with -o."),
    ):
        assert command("sweep", other, "-o", folder) == 2
        assert word in capsys.readouterr().err
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "Expecting value"),
        ('{"schema": ', "Expecting value"),
        ('{"schema": "jaxmpc-refine/1"}', "none of whose stages is there yet"),
    ],
    ids=["empty", "cut short", "of a refined sweep"],
)
def test_a_manifest_that_says_nothing_is_told_for_what_it_is(
    text: str, words: str, copy: Path, command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / "manifest.json").write_text(text)
    assert command("sweep", "best", copy) == 2
    assert words in capsys.readouterr().err


def test_a_full_disk_stops_cleanly_and_costs_nothing(
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    finished: Finished,
) -> None:
    path, folder = write_spec(spec_text), tmp_path / "run"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, hard))
    try:
        code = command("sweep", path, "-o", folder, "--quiet")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 1
    assert "cannot write: File too large" in capsys.readouterr().err
    assert list((folder / "chunks").iterdir()) == []
    assert command("sweep", path, "-o", folder, "--quiet") == 0
    assert finished[1].hash in capsys.readouterr().out


def test_ctrl_c_keeps_what_is_finished(
    spec: SweepSpec,
    spec_text: str,
    write_spec: Callable[[str], Path],
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    finished: Finished,
) -> None:
    path, folder, write = write_spec(spec_text), tmp_path / "run", stored.write_chunk

    def interrupted(*arguments: Any) -> None:
        if len(chunks(folder)) == 2:
            raise KeyboardInterrupt
        write(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(stored, "write_chunk", interrupted)
        assert command("sweep", path, "-o", folder, "--chunk", 32, "--quiet") == 130
    assert "run the same command again" in capsys.readouterr().err
    assert len(chunks(folder)) == 2
    assert run(spec, folder, chunk=32).hash == finished[1].hash


def test_of_two_sweeps_that_begin_at_once_one_has_the_folder(
    spec: SweepSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have found nothing there; the chunks of both would lie in it, left out by the other in turn."""
    first, second = make_plan(spec), make_plan(replace(spec, precision="float64"))
    look = store._begun
    for folder, begin in (
        (tmp_path / "plain", lambda plan: store.prepare(tmp_path / "plain", plan)),
        (tmp_path / "refined", lambda plan: store.prepare_refined(tmp_path / "refined", {}, plan.spec_hash)),
    ):
        begin(first)
        manifest = (folder / "manifest.json").read_bytes()
        looks = iter([False])
        monkeypatch.setattr(store, "_begun", lambda path, looks=looks: next(looks, None) is not False and look(path))
        with pytest.raises(InputError, match="of another spec"):
            begin(second)
        looks = iter([False])
        monkeypatch.setattr(store, "_begun", lambda path, looks=looks: next(looks, None) is not False and look(path))
        begin(first)
        assert (folder / "manifest.json").read_bytes() == manifest
        assert {path.name for path in folder.iterdir()} <= {"manifest.json", "chunks", "stages"}
    monkeypatch.setattr(os, "link", Mock(side_effect=OSError(errno.EPERM, "no links here")))
    store.prepare(tmp_path / "stick", first)
    assert store.read_plan(tmp_path / "stick").spec_hash == first.spec_hash
