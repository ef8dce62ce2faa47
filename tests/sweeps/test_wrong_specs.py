"""Every way to get a spec wrong: one sentence, and nothing is written."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from sweeps.spec import SweepSpec

Write = Callable[[str], Path]
Command = Callable[..., int]


WRONG = {
    "unknown key": ("kind =", "knid =", ["sweep.knid", "Did you mean 'kind'"]),
    "unknown table": ("[params]", "[parms]", ["parms", "Did you mean 'params'"]),
    "unknown parameter": ("T_cl", "T_lc", ["T_lc", "Did you mean 'T_cl'"]),
    "unknown experiment key": ("settle", "setle", ["experiment.setle", "Did you mean 'settle'"]),
    "unknown base parameter": ('"text"', '"text"\nlamda = 1', ["params.lamda", "Did you mean 'lam'", "spec.toml:10"]),
    "unknown published": ('"text"', '"txt"', ["txt", "Did you mean 'text'"]),
    "both sources": ('"text"', '"text"\nfile = "p.toml"', ["params.file", "Remove one"]),
    "missing file": ('published = "text"', 'file = "p.toml"', ["p.toml", "No such file"]),
    "nan in a list": (
        "[3, 10]",
        "[3, 10]\nK2 = [1.0, nan]",
        ["sweep.axes.K2", "nan", "[0, 10000] 1/s", "spec.toml:19"],
    ),
    "inf in a range": ("[0.001, 10.0]", "[0.001, inf]", ["sweep.axes.lam", "inf"]),
    "out of bounds": ("[3, 10]", "[3, 100]", ["sweep.axes.Hp", "100", "[1, 64] samples"]),
    "fractional horizon": ("[3, 10]", "[3.5, 10]", ["3.5", "a whole number"]),
    "empty list": ("[3, 10]", "[]", ["sweep.axes.Hp", "at least one value"]),
    "repetition": ("[3, 10]", "[3, 3]", ["sweep.axes.Hp", "free of repetition"]),
    "swapped ends": ("[0.001, 10.0]", "[10.0, 0.001]", ["sweep.axes.lam", "[smallest, largest]"]),
    "zero weight": ("[3, 10]", "[3, 10]\ndelta = [0.0, 1.0]", ["sweep.axes.delta", "above 0"]),
    "log from zero": ("[3, 10]", "[3, 10]\nQ_x = { log = [0, 1], points = 3 }", ["sweep.axes.Q_x", "above 0"]),
    "no points": (", points = 3", "", ["sweep.axes.T_cl.points", "given for a grid"]),
    "one point": ("points = 3", "points = 1", ["points", ">= 2"]),
    "both spacings": ("{ log = [0.001, 0.02]", "{ linear = [1, 2], log = [0.001, 0.02]", ["either linear or log"]),
    "rows of a grid": ('"grid"', '"grid"\nrows = 5', ["sweep.rows", "left out of a grid"]),
    "rows missing": ('"grid"', '"random"', ["sweep.rows", "missing"]),
    "too many rows": (
        "points = 40",
        "points = 90000 }\nK2 = { linear = [5, 50], points = 90",
        ["48600000 rows", "at most"],
    ),
    "no kind": ('kind = "grid"', "", ["sweep.kind", "missing"]),
    "negative stiffness": ("[375.0, 1900.0]", "[-1.0]", ["experiment.stiffness", "-1.0", "> 0"]),
    "Hu above Hp in the base": ('"text"', '"text"\nHp = 4', ["params.Hu", "Hp (= 4)"]),
    "Hu above Hp everywhere": ("[3, 10]", "[3, 4]", ["Hu", "no row is left"]),
    "negative T_cl": ("[0.001, 0.02]", "[-0.001, 0.02]", ["sweep.axes.T_cl", "-0.001"]),
    "nothing to score": (
        "z = -5.0",
        'z = [{ kind = "ramp", to = -5.0, rate = 2.0 }]',
        ["settle", "No sample is left to score"],
    ),
    "an axis of the arm on the linear loop": (
        "[3, 10]",
        "[3, 10]\n'arm.cable_hz' = [0.0, 30.0]",
        ["sweep.axes.arm.cable_hz", "the linear loop has none", "wam"],
    ),
    "duplicate key": ('kind = "grid"', 'kind = "grid"\nkind = "grid"', ["spec.toml:13", "kind"]),
    "a swing of the linear loop": ("[sweep]", '[sweep]\nbest = "swing"', ["sweep.best", "swing", "the linear loop"]),
    "a limited swing of it": (
        "[sweep]",
        "[sweep]\nconstraints = { M_s = 2.0, swing = 0.1 }",
        ["sweep.constraints", "swing", "the linear loop"],
    ),
    "a torque of it": ("[sweep]", '[sweep]\nbest = "joint_torque"', ["sweep.best", "joint_torque", "the linear loop"]),
    "a limited share of clamped samples of it": (
        "[sweep]",
        "[sweep]\nconstraints = { M_s = 2.0, clamped = 0.001 }",
        ["sweep.constraints", "clamped", "the linear loop"],
    ),
    "a stage that ends before it has settled": (
        "[sweep]",
        '[refine]\nmethod = "halving"\nstages = [{ keep = 5, experiment = { duration = 0.1 } }]\n[sweep]',
        ["refine.stages[0].experiment.settle", "below duration (= 0.1 s)"],
    ),
    "text for a number": ("[3, 10]", '[3, "10"]', ["sweep.axes.Hp", "a number"]),
    "a number for an axis": ("[3, 10]", "3", ["sweep.axes.Hp", "a list or a range"]),
    "a seed of nothing drawn": ("points = 3", "points = 3, seed = 1", ["sweep.axes.T_cl.seed = 1", "given with draw"]),
    "a table that is wrong within a list": (
        "[3, 10]",
        '[3, 10]\nreference.z = [[{ kind = "hold", force = -5.0 }], [{ kind = "hold" }]]',
        ["sweep.axes.reference.z", "a known key", "spec.toml:19"],
    ),
    "unknown key of an axis": ("points = 3", "pionts = 3", ["sweep.axes.T_cl.pionts", "Did you mean 'points'"]),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_specs_are_refused_before_anything_is_written(
    name: str, write_spec: Write, spec_text: str, command: Command, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    old, new, words = WRONG[name]
    assert old in spec_text
    path = write_spec(spec_text.replace(old, new, 1))
    assert command("sweep", path, "-o", "out") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "must be" in said
    assert [word for word in words if word not in said] == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]


@pytest.mark.parametrize(
    "axes",
    [
        '"arm.coulomb.²" = [1.0, 2.0]',
        f'"arm.coulomb.{"1" * 5000}" = [1.0, 2.0]',
        "guarded = { values = [0, 1], relative = true }",
        "architecture = { values = [], relative = true }",
        '"physics.1" = [1.0, 2.0]',
        '"tissue.kind.0" = ["a", "b"]',
        "Hu = [[1, 2], [3, 4]]",
        "Hu = [[{ kind = 1 }], [{ kind = 2 }]]",
        "Hp = [[10, 20], [30, 40]]",
    ],
)
def test_axes_that_name_nothing_are_refused_in_words(axes: str, write_spec: Write, command: Command) -> None:
    path = write_spec(f'[experiment]\npublished = "table-1-wam"\n[sweep]\nkind = "grid"\n[sweep.axes]\n{axes}\n')
    assert command("sweep", path, "--dry-run") == 2


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ("disturbance_order = [1, 2, 7]\nQ_p = [0.5, 1.0]", "sweep.axes.disturbance_order = 7"),
        ('architecture = ["mpc-aob", "nonsense"]', "sweep.axes.architecture = nonsense"),
        ("K2 = [[1.0, 2.0], [3.0, 4.0]]", "sweep.axes.K2"),
        ("lam = { values = [-1.0, 2.0], relative = true }", "sweep.axes.lam = -1"),
        ("settle = [0.5, 1.5]\nduration = [1.0, 2.0]", "sweep.axes.settle = 1.5"),
        ("Hp = { values = [0.5, 1.0], relative = true }", "sweep.axes.Hp.relative"),
        ('Hu = [1]\nHp = [1, 10]\narchitecture = ["aob", "mpc"]', "sweep.axes.Hp = 1: must be at least 2"),
    ],
)
def test_one_bad_value_is_refused_before_it_loses_the_rows_beside_it(
    axes: str, words: str, write_spec: Write, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment = '[experiment]\npublished = "table-1"\nduration = 2.0\nsettle = 0.5\nreference = { z = -5.0 }\n'
    text = f'{experiment}[sweep]\nkind = "grid"\n[sweep.axes]\n{axes}\n'
    assert command("sweep", write_spec(text), "--dry-run") == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("times", [[0.001, 0.01], {"linear": [0.001, 0.01], "points": 3}])
@pytest.mark.parametrize("swept", [False, True])
def test_a_guard_that_a_row_samples_too_slowly_is_refused(times: Any, swept: bool) -> None:
    params = {"published": "cautious", "guarded": not swept}
    axes: dict[str, Any] = {"sampling_time": times} | ({"guarded": [False, True]} if swept else {})
    sweep = {"kind": "grid", "axes": axes}
    with pytest.raises(InputError, match="guarded"):
        SweepSpec.from_dict({"experiment": {"published": "table-1-wam"}, "params": params, "sweep": sweep})


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_a_sample_whose_horizons_always_cross_is_refused(
    kind: str, write_spec: Write, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    sample = f'[sweep]\nkind = "{kind}"\nrows = 8\n[[sweep.zip]]\nHp = [4, 10]\nHu = [5, 15]\n'
    assert command("sweep", write_spec(f'[experiment]\npublished = "table-1"\n{sample}'), "--dry-run") == 2
    assert "Hu" in capsys.readouterr().err


@pytest.mark.parametrize("axis", ['["a.csv", "b.csv"]', '{ values = ["a.csv", "b.csv"] }', '"a.csv"', "7"])
def test_recordings_are_looked_for_beside_the_spec(
    axis: str, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "ab":
        rows = "".join(f"{0.01 * t},0,0,{1e-5 * t}\n" for t in range(101))
        (tmp_path / f"{name}.csv").write_text(f"t,x,y,z\n{rows}")
    spec = tmp_path / "spec.toml"
    spec.write_text(
        '[experiment]\npublished = "table-1"\nmotion = { kind = "recording", file = "a.csv", repeat = true }\n'
        f'[sweep]\nkind = "grid"\n[sweep.axes]\n"motion.file" = {axis}\n'
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    listed = "b.csv" in axis
    assert command("sweep", spec, "--dry-run") == (0 if listed else 2), capsys.readouterr().err
    assert listed or "motion.file" in capsys.readouterr().err


def test_a_wrong_value_among_hundreds_is_refused_before_it_loses_the_others() -> None:
    stiffness = [*np.linspace(100.0, 300.0, 200).tolist(), -5.0, *np.linspace(301.0, 500.0, 200).tolist()]
    with pytest.raises(InputError, match=r"sweep\.axes\.stiffness = .*-5"):
        SweepSpec.from_dict({"sweep": {"kind": "grid", "axes": {"stiffness": stiffness}}})


def test_a_vector_and_its_entry_are_not_both_swept(
    write_spec: Write, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    text = '[experiment]\npublished = "table-1-wam"\n[sweep]\nkind = "grid"\n[sweep.axes]\n'
    axes = '"arm.coulomb.2" = [0.1, 0.2]\n"arm.coulomb" = [[1.0, 1.0, 1.0, 1.0], [2.0, 1.0, 1.0, 1.0]]\n'
    assert command("sweep", write_spec(text + axes), "--dry-run") == 2
    assert "part of arm.coulomb" in capsys.readouterr().err


def test_an_entry_has_one_name() -> None:
    """Under two it was swept twice: the axis that stood last set it, and rows were there several times."""
    axes = {"arm.coulomb.2": [0.1, 0.2], "arm.coulomb.02": [0.3, 0.4]}
    with pytest.raises(InputError, match=r"sweep\.axes\.arm\.coulomb\.02 = swept: must be a known parameter"):
        SweepSpec.from_dict({"experiment": {"published": "table-1-wam"}, "sweep": {"kind": "grid", "axes": axes}})


def test_the_real_command_refuses_without_a_traceback(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    path = write_spec(spec_text.replace("[3, 10]", "[3, nan]"))
    done = subprocess.run(
        [sys.executable, "-m", "jaxmpc", "sweep", str(path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert f"{path}:18: sweep.axes.Hp = nan" in done.stderr
    assert not (tmp_path / "runs").exists()
