"""Identification on recordings of an arm whose friction and masses are known, made without the package."""

import argparse
import re
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import mujoco
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from jaxmpc.cli import identify as verb
from jaxmpc.experiment.tables import ArmSettings
from jaxmpc.files.errors import InputError
from jaxmpc.identify.friction_fit import Band, JointData, bristle
from jaxmpc.identify.identification import COLUMNS, MotionRecording, identify, read_recording

WAM = Path(__file__).parents[2] / "jaxmpc" / "world" / "wam.xml"
MOTORS = np.array([[-42, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18]])
"""Motor turns per joint turn."""


class Truth(NamedTuple):
    coulomb: np.ndarray
    viscous: np.ndarray
    presliding: np.ndarray
    offset: np.ndarray
    masses: float


ARM = Truth(
    coulomb=np.array([2.2, 1.4, 0.9, 0.7]),
    viscous=np.array([1.6, 1.1, 0.45, 0.3]),
    presliding=np.array([1.0e-3, 1.5e-3, 0.8e-3, 2.0e-3]),
    offset=np.array([0.1, -0.2, 0.05, 0.02]),
    masses=0.92,
)


def excitation(t: np.ndarray) -> np.ndarray:
    """q, q̇, q̈ of multi-sines with slow reversals, other frequencies for each joint, shape (3, n, 4)."""
    orders = []
    for derivative in range(3):
        rng = np.random.default_rng(5)
        q = np.zeros((len(t), 4))
        for joint in range(4):
            for f, amplitude in ((0.07, 0.18), (0.31, 0.18), (0.53, 0.12), (0.97, 0.075)):
                w = 2.0 * np.pi * f * (1.0 + 0.13 * joint)
                phase = rng.uniform(0.0, 2.0 * np.pi) + derivative * np.pi / 2.0
                q[:, joint] += amplitude * w**derivative * np.sin(w * t + phase)
        orders.append(q)
    orders[0] += [0.0, 0.7, 0.0, 1.6]
    return np.stack(orders)


def bristles(t: np.ndarray, qdot: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Dahl's equation by Heun's method at the given times, which are fine."""
    s, found = np.zeros(qdot.shape[1]), np.empty_like(qdot)
    speed = np.sqrt(qdot**2 + 1e-6)
    h = t[1] - t[0]
    for k in range(len(t)):
        found[k] = s
        if k + 1 < len(t):
            first = (qdot[k] - speed[k] * s) / z
            second = (qdot[k + 1] - speed[k + 1] * (s + h * first)) / z
            s = s + 0.5 * h * (first + second)
    return found


@cache
def recording(seconds: float = 8.0, rate: int = 500, noise: float = 0.05) -> MotionRecording:
    """What the arm's encoders and drives tell: 4096 counts a motor turn, torques of 1/2700 N m per motor and noise."""
    fine = 4
    t = np.arange(0.0, seconds, 1.0 / rate / fine)
    q, qdot, qddot = excitation(t)
    s = bristles(t, qdot, ARM.presliding)
    t, q, qdot, qddot, s = t[::fine], q[::fine], qdot[::fine], qddot[::fine], s[::fine]
    model = mujoco.MjModel.from_xml_path(str(WAM))
    model.body_mass[1:6] *= ARM.masses
    model.body_inertia[1:6] *= ARM.masses
    model.dof_damping[:4] = ARM.viscous
    data = mujoco.MjData(model)
    tau = np.empty_like(q)
    for k in range(len(t)):
        data.qpos[:4], data.qvel[:4], data.qacc[:4] = q[k], qdot[k], qddot[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse[:4]
    tau += ARM.coulomb * s + ARM.offset + np.random.default_rng(0).normal(0.0, noise, tau.shape)
    count = 2.0 * np.pi / 4096
    encoders = np.linalg.solve(MOTORS, np.round(MOTORS @ q.T / count) * count).T
    drives = MOTORS.T @ (np.floor(np.linalg.solve(MOTORS.T, tau.T) * 2700.0 + 0.5) / 2700.0)
    return MotionRecording(t, encoders, drives.T)


def test_the_excitation_is_consistent():
    t = np.arange(0.0, 2.0, 1e-3)
    q, qdot, qddot = excitation(t)
    np.testing.assert_allclose(cumulative_trapezoid(qdot, t, axis=0, initial=0.0), q - q[0], atol=1e-5)
    np.testing.assert_allclose(cumulative_trapezoid(qddot, t, axis=0, initial=0.0), qdot - qdot[0], atol=1e-4)


def test_known_parameters_are_recovered_within_their_errors():
    found = identify(recording(seconds=16.0))
    names = ("coulomb", "viscous", "presliding", "offset")
    off = np.array([(getattr(found, name).value - getattr(ARM, name)) / getattr(found, name).error for name in names])
    off = np.append(off, (found.mass_scale - ARM.masses) / found.mass_scale_error)
    assert np.abs(off).max() < 3.5
    assert np.sqrt(np.mean(off**2)) < 1.6
    for name, largest in (("coulomb", 0.01), ("viscous", 0.02), ("presliding", 0.04)):
        np.testing.assert_allclose(getattr(found, name).value, getattr(ARM, name), rtol=largest)
        # An error bar that says nothing would pass the test above.
        assert (getattr(found, name).error < largest * getattr(ARM, name)).all()
    assert found.mass_scale == pytest.approx(ARM.masses, rel=2e-3)
    assert (found.r_squared > 0.998).all()
    assert (found.rms < 0.05).all()


def test_slope_of_the_bristle_against_central_differences():
    t = np.arange(0.0, 2.0, 2e-3)
    q, qdot, _ = excitation(t)[:, :, 0]
    joint = JointData(np.diff(q), np.diff(t), Band(500.0, 15.0, slice(None)), qdot, q, q)
    log_z = np.log(3e-3)
    high, low = (bristle(joint, log_z + h)[0] for h in (1e-5, -1e-5))
    s, slope = bristle(joint, log_z)
    np.testing.assert_allclose(slope, (high - low) / 2e-5, atol=1e-8)
    assert np.abs(slope).max() > 0.1
    np.testing.assert_allclose(s, joint.band(bristles(t, qdot[:, None], np.array([3e-3]))[:, 0]), atol=0.02)


def test_offsets_are_optional():
    t, q, tau = recording()
    found = identify(MotionRecording(t, q, tau - ARM.offset), offsets=False)
    assert (found.offset.value == 0.0).all()
    np.testing.assert_allclose(found.coulomb.value, ARM.coulomb, rtol=0.01)
    assert found.mass_scale == pytest.approx(ARM.masses, rel=1e-3)


def table_of(r: MotionRecording) -> np.ndarray:
    return np.column_stack([r.t, r.q, r.tau])


def with_column(name: str, change: Callable[[np.ndarray], np.ndarray]) -> MotionRecording:
    table = table_of(recording())
    table[:, COLUMNS.index(name)] = change(table[:, 0].copy())
    return MotionRecording(table[:, 0], table[:, 1:5], table[:, 5:])


def jumps_back(t: np.ndarray) -> np.ndarray:
    t[100] = t[99] - 0.01
    return t


@pytest.mark.parametrize(
    ("wrong", "key", "said"),
    [
        pytest.param(lambda: MotionRecording(*(part[:999] for part in recording())), "samples", "999", id="short"),
        pytest.param(lambda: with_column("t", jumps_back), "t", "at sample 101", id="backwards"),
        pytest.param(lambda: with_column("t", lambda t: 3.0 * t), "sampling", "at least 200 Hz", id="slow"),
        pytest.param(lambda: with_column("q2", lambda t: 0.0 * t), "q2", "Move J2 too", id="still"),
        pytest.param(lambda: with_column("q3", lambda t: 0.1 * t), "q3", "moved both ways", id="one way"),
    ],
)
def test_a_recording_that_cannot_serve(wrong: Callable[[], MotionRecording], key: str, said: str):
    with pytest.raises(InputError) as raised:
        identify(wrong())
    assert raised.value.key == key
    assert said in str(raised.value)


@pytest.mark.parametrize("cutoff", [0.0, 50.0])
def test_a_cutoff_that_cannot_serve(cutoff: float):
    with pytest.raises(InputError, match=r"at most 41\.6667 Hz"):
        identify(recording(), cutoff)


def csv(path: Path, table: np.ndarray, names: tuple[str, ...] = COLUMNS) -> list[str]:
    lines = [",".join(names), *(",".join(map(repr, row)) for row in table.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return lines


def test_recordings_are_read_as_written(tmp_path: Path):
    wanted = table_of(recording())[:50]
    # Another order, one column more, an empty line and a byte order mark do no harm.
    names = ("tau4", "comment", *COLUMNS[:-1])
    lines = csv(tmp_path / "a.csv", np.column_stack([wanted[:, 8], wanted[:, 0], wanted[:, :8]]), names)
    (tmp_path / "a.csv").write_text("\n".join([*lines[:9], "", *lines[9:]]), encoding="utf-8-sig")
    np.savez(tmp_path / "a.npz", **dict(zip(COLUMNS, wanted.T, strict=True)))
    for name in ("a.csv", "a.npz"):
        np.testing.assert_array_equal(table_of(read_recording(tmp_path / name)), wanted)


def nan(lines: list[str]) -> list[str]:
    return [*lines[:7], "nan" + lines[7][lines[7].index(",") :], *lines[8:]]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        pytest.param(lambda lines: ["t,q1,q2,q3,q4", *lines[1:]], ":1: columns = t, q1, q2, q3, q4", id="columns"),
        pytest.param(lambda lines: ["t,q1,q2,q3,q4", *lines[1:]], "Add tau1, tau2, tau3, tau4", id="which"),
        pytest.param(nan, ":8: t = nan: must be finite", id="nan"),
        pytest.param(lambda lines: [*lines[:2], "", *nan(lines)[2:]], ":9: t = nan", id="nan after an empty line"),
        pytest.param(lambda lines: [*lines[:4], "1,2,x", *lines[5:]], ":5: row = 1,2,x", id="no number"),
        pytest.param(lambda lines: [*lines[:4], "1,2", *lines[5:]], ":5: row = 1,2", id="cut row"),
        pytest.param(lambda lines: [], "columns = none", id="empty"),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, spoil, said: str):
    lines = csv(tmp_path / "r.csv", table_of(recording())[:20])
    (tmp_path / "r.csv").write_text("\n".join(spoil(lines)))
    with pytest.raises(InputError) as raised:
        read_recording(tmp_path / "r.csv")
    assert said in str(raised.value)


def test_archives_that_cannot_be_read(tmp_path: Path):
    columns = dict(zip(COLUMNS, table_of(recording())[:20].T, strict=True))
    broken = tmp_path / "r.npz"
    for content, said in (({**columns, "q1": columns["q1"][:5]}, "equally long"), ({"t": columns["t"]}, "Add q1, q2")):
        np.savez(broken, **content)
        with pytest.raises(InputError, match=said):
            read_recording(broken)
    broken.write_bytes(b"no archive")
    with pytest.raises(InputError, match="must be"):
        read_recording(broken)
    with pytest.raises(InputError, match="No such file"):
        read_recording(tmp_path / "none.csv")


def call(*words: object) -> int:
    parser = argparse.ArgumentParser()
    verb.configure(parser)
    return verb.run(parser.parse_args([str(word) for word in words]))


def test_the_verb_prints_writes_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    csv(tmp_path / "r.csv", table_of(recording()))
    assert call(tmp_path / "r.csv", "-o", tmp_path / "f.toml", "--figure", tmp_path / "f.png") == 0
    told = capsys.readouterr().out
    assert "N m s/rad" in told
    # J2's Coulomb friction, of 1.4 N m, and the masses.
    assert re.search(r"J2 +1\.(39|40)\d ± 0\.00\d", told)
    assert re.search(r"model's: 0\.9(19|20)\d ± 0\.000\d", told)
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
    arm = msgspec.convert(tomllib.loads((tmp_path / "f.toml").read_text())["arm"], ArmSettings, strict=True)
    np.testing.assert_allclose(arm.coulomb, ARM.coulomb, rtol=0.01)
    np.testing.assert_allclose(arm.viscous, ARM.viscous, rtol=0.02)
    assert arm.presliding == pytest.approx(np.prod(ARM.presliding) ** 0.25, rel=0.02)
    assert arm.mass_error == pytest.approx(1.0 / ARM.masses - 1.0, abs=1e-3)


def test_wrong_input_writes_nothing(tmp_path: Path):
    csv(tmp_path / "r.csv", table_of(with_column("q1", lambda t: 0.0 * t)))
    before = sorted(tmp_path.iterdir())
    for words, said in (
        ([tmp_path / "r.csv", "-o", tmp_path / "f.toml"], r"r\.csv: q1 = a span of 0 rad"),
        ([tmp_path / "r.csv", "-o", tmp_path / "f.toml", "--figure", tmp_path / "f.doc"], r"\.png, \.svg, \.pdf"),
    ):
        with pytest.raises(InputError, match=said):
            call(*words)
    assert sorted(tmp_path.iterdir()) == before
