import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.controller.file import to_bytes
from deploy.controller.freeze import freeze
from deploy.controller.recomputed_margins import margins_at
from jaxmpc.cli import main
from tests.deploy import made


def with_margins(artifact):
    """The same with the margins that its gains really have, and a floor that they keep."""
    rows = [margins_at(artifact, row["stiffness"]) for row in artifact.margins]
    return replace(artifact, margins=rows, floor={"M_s": 2.0 if max(row["M_s"] for row in rows) < 2.0 else 5.0})


def test_good_artifact(arguments, tmp_path, capsys):
    path = tmp_path / "controller.npz"
    path.write_bytes(to_bytes(with_margins(freeze(path, **arguments))))
    assert main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    assert hashlib.sha256(path.read_bytes()).hexdigest() in out
    for words in ("intact", "1900", "M_s", "≤ 5", "< 1", "12 samples replayed", "µs", "Khat_s 900", ": the same"):
        assert words in out
    assert "kind        linear, replay only" in out
    assert "robot" not in out


def test_good_artifact_of_an_arm(arm_artifact, tmp_path, capsys):
    path = tmp_path / "controller.npz"
    path.write_bytes(to_bytes(with_margins(arm_artifact)))
    assert main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "gain        not guarded" in out
    assert " -\n" not in out, "what has no unit"
    for words in ("kind        wam, runs", "Barrett WAM 4-DoF", "0.36 m", "× 0.9", "40 samples replayed", "1e-09 N m"):
        assert words in out
    for name in arm_artifact.arm.limits.plain():
        assert f"  {name} " in out
    assert f"force{15:>19} N" in out
    assert "tick of the arm" in out


def test_good_artifact_with_a_guard(tmp_path, capsys):
    path, gains = tmp_path / "controller.npz", made.guarded_gains()
    path.write_bytes(to_bytes(with_margins(made.arm_artifact(6, gains=gains))))
    assert main(["check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "gain        guarded: falls when the force swings by some 0.2 N (RMS), or by 0.049 N for long" in said
    assert "or when the limits hold back 5 m/s²" in said


@pytest.mark.parametrize(
    ("key", "declared"),
    [
        ("M_s", 1.0),
        ("M_s", 4.3),
        ("gain_margin_db", 17.0),
        ("gain_reduction_db", 20.0),
        ("phase_margin_deg", 60.0),
        ("delay_margin_s", 2e-3),
        ("spectral_radius", 0.9),
    ],
)
def test_margins_that_the_gains_do_not_have_are_told(arm_artifact, tmp_path, capsys, key, declared):
    path = tmp_path / "controller.npz"
    true = with_margins(arm_artifact)
    path.write_bytes(to_bytes(replace(true, margins=[true.margins[0] | {key: declared}, *true.margins[1:]])))
    assert main(["check", str(path)]) == 1
    said = capsys.readouterr()
    assert "they DIFFER" in said.out
    assert f"    {key} at 375 N/m: declared " in said.out
    assert "its margins are not those of its gains" in said.err
    assert said.err.count("\n") == 1


def test_an_unstable_loop_that_is_declared_stable_is_told(arm_artifact, tmp_path, capsys):
    path = tmp_path / "controller.npz"
    path.write_bytes(to_bytes(replace(with_margins(arm_artifact), margins=[made.margin_row(20_000.0)])))
    assert main(["check", str(path)]) == 1
    assert "spectral_radius at 20000 N/m: declared 0.98, computed 1." in capsys.readouterr().out


def test_margins_of_what_cannot_be_computed_are_none(arm_artifact):
    row = margins_at(arm_artifact, 1e308)
    assert row["spectral_radius"] == row["M_s"] == float("inf")


def test_a_reader_who_has_had_enough_is_no_failure(arguments, tmp_path):
    path = tmp_path / "controller.npz"
    freeze(path, **arguments)
    read, write = os.pipe()
    os.close(read)
    try:
        found = subprocess.run([sys.executable, "-m", "jaxmpc", "check", path], stdout=write, stderr=subprocess.PIPE)
    finally:
        os.close(write)
    assert (found.returncode, found.stderr) == (141, b"")


def test_refused_artifact(arguments, tmp_path, capsys):
    path = tmp_path / "controller.npz"
    freeze(path, **arguments)
    path.write_bytes(path.read_bytes()[:-1])
    assert main(["check", str(path)]) == 1
    output = capsys.readouterr()
    assert "refused: " in output.err
    assert "cut short" in output.err
    assert output.out == ""


def test_what_is_no_file_is_refused(tmp_path, capsys):
    (tmp_path / "x").symlink_to("x")
    assert main(["check", str(tmp_path / "x")]) == 1
    assert "refused: " in capsys.readouterr().err


def test_what_can_be_no_controller_is_wrong_input(tmp_path, capsys):
    (tmp_path / "my best.toml").write_text("[params]")
    for path, words in (
        (tmp_path / "my best.toml", f"`jaxmpc freeze '{tmp_path}/my best.toml' --experiment"),
        (tmp_path, "folder"),
        (Path("/dev/null"), "device"),
    ):
        assert main(["check", str(path)]) == 2
        assert words in capsys.readouterr().err


def test_missing_file_is_wrong_input(tmp_path, capsys):
    assert main(["check", str(tmp_path / "none.npz")]) == 2
    assert "must be an existing file" in capsys.readouterr().err
