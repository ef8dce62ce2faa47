"""Recordings of the heart are played smoothly and read with suspicion."""

import string
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmpc import InputError
from jaxmpc.experiment import Experiment
from jaxmpc.world.heart.motion import Motion, displacement
from jaxmpc.world.heart.recording import read_recording
from tuning import TuneSpec

T = np.arange(0.0, 40.0, 1e-3)


def assert_velocity(motion: Motion, t: np.ndarray) -> None:
    step = 2e-5
    velocity = displacement(motion, t)[1]
    difference = (displacement(motion, t + step)[0] - displacement(motion, t - step)[0]) / (2.0 * step)
    largest = np.abs(displacement(motion, np.arange(0.0, t[-1], 0.01))[1]).max()
    np.testing.assert_allclose(velocity, difference, rtol=0.0, atol=1e-6 * max(largest, 1e-3))


def jump_of_acceleration(motion: Motion, step: float) -> float:
    velocity = displacement(motion, np.arange(8.0, 15.0, step))[1]
    return float(np.abs(np.diff(velocity, 2, axis=0)).max()) / step


def write_csv(path: Path, rows: np.ndarray, header: str = "t,x,y,z") -> Path:
    lines = [header, *(",".join(f"{cell:.9g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def recording(rate: float = 100.0, seconds: float = 4.0) -> np.ndarray:
    t = np.arange(0.0, seconds, 1.0 / rate)
    return np.column_stack([t, 3e-3 * np.sin(2 * np.pi * np.outer(t, [1.0, 2.0, 3.0]))])


def play(path: Path, **keys: Any) -> Motion:
    return Motion(kind="recording", file=str(path), **keys)


def test_recording_is_played_with_continuous_acceleration(tmp_path: Path) -> None:
    fine = np.arange(0.0, 3.9, 1e-3)
    played = displacement(play(write_csv(tmp_path / "r.csv", recording()), fade=0.0), fine)[0]
    np.testing.assert_allclose(played[:, 1], 3e-3 * np.sin(4 * np.pi * fine), atol=2e-5)
    acceleration = np.diff(played, 2, axis=0) / 1e-6
    assert np.abs(acceleration).max() < 1.2 * 3e-3 * (6 * np.pi) ** 2


def test_what_results_depend_on_is_what_a_recording_holds_not_where_it_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_csv(tmp_path / "heart.csv", recording())
    monkeypatch.chdir(tmp_path)
    motion = {"kind": "recording", "repeat": True}
    near, far = (
        Experiment.from_dict({**Experiment.published("table-1").to_dict(), "motion": {**motion, "file": file}})
        for file in ("heart.csv", str(path))
    )
    assert near.content == far.content
    jobs = [TuneSpec.from_dict({"experiment": data.to_dict()}).digest for data in (near, far)]
    assert jobs[0] == jobs[1]
    write_csv(path, 1.5 * recording())
    assert far.content != near.to_dict()
    assert TuneSpec.from_dict({"experiment": far.to_dict()}).digest not in jobs


def test_npz_and_millimetres_are_the_same_recording(tmp_path: Path) -> None:
    rows = recording()
    np.savez(tmp_path / "r.npz", t=rows[:, 0], x=1e3 * rows[:, 1], y=1e3 * rows[:, 2], z=1e3 * rows[:, 3])
    from_csv = read_recording(write_csv(tmp_path / "r.csv", rows))
    from_npz = read_recording(tmp_path / "r.npz", "mm")
    np.testing.assert_allclose(from_npz[1], from_csv[1], atol=1e-10)


def test_repeated_recording_rests_between(tmp_path: Path) -> None:
    motion = play(write_csv(tmp_path / "r.csv", recording()), repeat=True, fade=0.0)
    played = displacement(motion, np.arange(0.0, 12.0, 1e-3))[0]
    assert not played[4100:4900].any()
    np.testing.assert_allclose(played[1000:2000], played[1000 + 4990 : 2000 + 4990], atol=1e-3)
    assert jump_of_acceleration(motion, 1e-4) < 0.2 * jump_of_acceleration(motion, 1e-3)


@pytest.mark.parametrize("repeat", [False, True])
def test_velocity_of_a_recording_is_the_derivative(tmp_path: Path, repeat: bool) -> None:
    path = write_csv(tmp_path / "r.csv", recording(seconds=10.0))
    motion = play(path, repeat=repeat, start=0.7, scale=1.5)
    assert_velocity(motion, np.sort(np.random.default_rng(0).uniform(0.1, 30.0 if repeat else 9.9, 500)))


def damaged(kind: str) -> tuple[np.ndarray, str]:
    rows, header = recording(), "t,x,y,z"
    match kind:
        case "nan":
            rows[17, 2] = np.nan
        case "infinite":
            rows[17, 3] = np.inf
        case "gap":
            rows = np.delete(rows, slice(100, 110), axis=0)
        case "backwards":
            rows[50, 0] = rows[48, 0]
        case "slow":
            rows = recording(rate=20.0)
        case "milliseconds":
            rows[:, 0] *= 1e3
        case "millimetres":
            rows[:, 1:] *= 1e3
        case "jump":
            rows[40, 2] = -5.0
        case "columns":
            header = "time,x,y,z"
        case "missing axis":
            rows, header = rows[:, :3], "t,x,y"
        case "short":
            rows = rows[:3]
        case "empty":
            rows = rows[:0]
    return rows, header


DAMAGE = [
    ("nan", 19, ["y = nan", "finite"]),
    ("infinite", 19, ["z = inf", "finite"]),
    ("gap", 102, ["a gap of 0.11 s"]),
    ("backwards", 52, ["t = 0.48 s after 0.49 s", "increasing"]),
    ("slow", 3, ["20 Hz", "at least 50 Hz"]),
    ("milliseconds", 3, ["0.1 Hz", "convert it to seconds"]),
    ("millimetres", None, ["peak to peak", "at most 0.1 m", 'motion.unit = "mm"']),
    ("jump", 42, ["y = 5", "peak to peak"]),
    ("columns", 1, ["time, x, y, z", "must be t, x, y, z"]),
    ("missing axis", 1, ["t, x, y"]),
    ("short", 4, ["rows = 3"]),
    ("empty", 1, ["rows = 0"]),
]


@pytest.mark.parametrize(("kind", "line", "words"), DAMAGE)
def test_damaged_recording_is_refused_with_its_place(
    tmp_path: Path, kind: str, line: int | None, words: list[str]
) -> None:
    path = write_csv(tmp_path / "r.csv", *damaged(kind))
    with pytest.raises(InputError) as caught:
        displacement(play(path, repeat=True), T)
    for word in [*words, f"{path}:{'' if line is None else f'{line}: '}"]:
        assert word in str(caught.value)


@pytest.mark.parametrize(("kind", "line", "words"), DAMAGE)
def test_damaged_npz_is_refused_without_a_line(tmp_path: Path, kind: str, line: int | None, words: list[str]) -> None:
    rows, header = damaged(kind)
    np.savez(tmp_path / "r.npz", **dict(zip(header.split(","), rows.T, strict=True)))
    with pytest.raises(InputError) as caught:
        read_recording(tmp_path / "r.npz")
    for word in [*words, f"{tmp_path / 'r.npz'}: "]:
        assert word in str(caught.value)


def test_recording_shorter_than_the_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="repeat = true"):
        displacement(play(write_csv(tmp_path / "r.csv", recording())), T)


def test_cell_that_is_no_number_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("t,x,y,z\n0,0,0,0\n0.01,zero,0,0\n")
    with pytest.raises(InputError, match=r"r\.csv:3"):
        read_recording(tmp_path / "r.csv")


def test_pickled_arrays_are_never_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", t=np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="pickle"):
        read_recording(tmp_path / "r.npz")


def test_what_is_no_recording_is_refused_with_its_name(tmp_path: Path) -> None:
    rows = recording()
    np.savez(tmp_path / "whole.npz", t=rows[:, 0], x=rows[:, 1], y=rows[:, 2], z=rows[:, 3])
    whole = (tmp_path / "whole.npz").read_bytes()
    np.save(tmp_path / "bare.npy", rows)
    np.savez(tmp_path / "uneven.npz", t=rows[:, 0], x=rows[1:, 1], y=rows[:, 2], z=rows[:, 3])
    contents = [b"", b"\xff\xfe", whole[:500], whole[:-30], (tmp_path / "bare.npy").read_bytes()]
    contents += [(tmp_path / "uneven.npz").read_bytes(), whole[:900] + b"\0" * 40 + whole[940:]]
    for content in contents:
        (tmp_path / "r.npz").write_bytes(content)
        (tmp_path / "r.csv").write_bytes(content)
        for name in ("r.npz", "r.csv"):
            with pytest.raises(InputError, match=name):
                read_recording(tmp_path / name)


@settings(max_examples=40, deadline=None)
@given(
    header=st.sampled_from(["t,x,y,z", "z,y,x,t", "t,x", "﻿t,x,y,z"]),
    rows=st.lists(st.lists(st.floats() | st.text(string.printable, max_size=3), min_size=3, max_size=5), max_size=6),
)
def test_any_text_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, header: str, rows: list[list[Any]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]), encoding="utf-8")
    try:
        t, values = read_recording(path)
    except InputError:
        return
    assert np.isfinite(t).all()
    assert np.isfinite(values).all()


def test_metres_that_are_called_millimetres_are_told(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "r.csv", recording())
    read_recording(path, "m")
    with pytest.raises(InputError, match=r'0\.006 mm peak to peak.*set motion\.unit = "m"'):
        read_recording(path, "mm")
    still = np.column_stack([recording()[:, 0], np.zeros((400, 3))])
    read_recording(write_csv(tmp_path / "still.csv", still), "mm")


def test_an_experiment_has_the_name_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "my tissue.toml").write_text("duration = 8.0\n")
    assert Experiment.from_toml(tmp_path / "my tissue.toml").name == "my tissue"
    (tmp_path / "a.toml").write_text('name = "b"\n')
    assert Experiment.from_toml(tmp_path / "a.toml").name == "b"
    (tmp_path / "a@b.toml").write_text("duration = 8.0\n")
    assert Experiment.from_toml(tmp_path / "a@b.toml").name == "experiment"
    (tmp_path / "empty.toml").write_text("# nothing\n")
    with pytest.raises(InputError, match="a file with a key at least"):
        Experiment.from_toml(tmp_path / "empty.toml")
