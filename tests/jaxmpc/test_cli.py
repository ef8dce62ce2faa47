"""The command line: exit codes, one sentence for wrong input, nothing written then; freeze end to end."""

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from deploy.controller.file import load
from deploy.controller.golden import replay
from jaxmpc import Experiment, InputError, Params, evaluate, evaluation, stability, synthesis
from jaxmpc.cli import VERBS, comparison, main
from jaxmpc.cli.simulate import simulated, with_heart_still, without_motion
from jaxmpc.files.toml import write_toml
from jaxmpc.loop.arm import ArmSample
from jaxmpc.pictures.film import SIZE, film
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.xla import store
from jaxmpc.xla.once import JitOnce
from tests.sources import ROOT

TUNED = {"K2": 100.0, "Khat_s": 970.0, "Q_p": 9.0, "T_cl": 2e-4}


def params_file(folder: Path, text: str) -> str:
    (folder / "p.toml").write_text(text)
    return str(folder / "p.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[params]\nlamda = 1.0", ["p.toml:2", "lamda", "Did you mean 'lam'"]),
        ("[params]\nlam = nan", ["p.toml:2", "lam = nan", "[1e-12, 1e+12]"]),
        ("[params]\nHp = 10\nHu = 12", ["p.toml:3", "Hu = 12", "[1, Hp (= 10)]", "raise Hp"]),
        ("[params]\nHp = 65", ["p.toml:2", "Hp = 65", "[1, 64]"]),
        ("[params]\nHp = 10.5", ["p.toml:2", "Hp = 10.5", "whole number"]),
        ("[params]\nT_cl = 0.0", ["p.toml:2", "T_cl = 0.0"]),
        ("[params]\nKhat_s = -5.0", ["p.toml:2", "Khat_s = -5.0"]),
        ('[params]\nQ_p = "big"', ["p.toml:2", "Q_p = big", "a number"]),
        ("[params]\nK2 = [1.0, 2.0]", ["p.toml:2", "K2", "one number"]),
        ("[params]\ndelta = 0.0", ["p.toml:2", "delta", "positive somewhere"]),
        ('[params]\narchitecture = "pid"', ["p.toml:2", "pid", "mpc-aob"]),
        ("[params]\nlam = 1.0\nlam = 2.0", ["p.toml:3", "Cannot overwrite"]),
        ("[parms]\nlam = 1.0", ["p.toml:1", "parms", "Did you mean 'params'"]),
        ("lam = [", ["p.toml", "valid TOML"]),
    ],
)
def test_wrong_parameters_exit_2_with_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: list[str]
) -> None:
    path, output = params_file(tmp_path, text), tmp_path / "c.npz"
    assert main(["freeze", path, "-o", str(output)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    for word in [*words, "must be"]:
        assert word in told
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "table-2"], ["table-2", "figure-3", "table-1"]),
        (["simulate", "family"], ["family is a controller (for --params)", "table-1-wam"]),
        (["simulate", "table-1", "--video"], ["--video", "--physics wam"]),
        (["simulate", "table-1-wam", "--video", "film.avi"], ["film.avi", "film.mp4"]),
        (["simulate", "gone.toml"], ["gone.toml", "No such file"]),
        (["simulate", "table-1", "--params", "bogus"], ["bogus", "text, printed"]),
        (["freeze", "text"], ["M_s at 375", "at most 2"]),
        (["freeze", "printed"], ["spectral radius", "below 1"]),
    ],
)
def test_wrong_arguments_exit_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    told = capsys.readouterr().err
    for word in words:
        assert word in told
    assert list(tmp_path.iterdir()) == []


def test_no_traceback_from_a_process_either(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "jaxmpc", "freeze", params_file(tmp_path, "[params]\nlam = -1.0")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_short_closed_loop_time_is_allowed(tmp_path: Path) -> None:
    """T_cl below the sampling time is useful: a nearly dead-beat reference."""
    assert float(Params.from_toml(params_file(tmp_path, "[params]\nT_cl = 0.0001")).T_cl) == 1e-4


@pytest.mark.oracle
def test_frozen_controller_is_the_simulated_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_toml(tmp_path / "p.toml", {"params": TUNED})
    output = tmp_path / "c.npz"
    assert main(["freeze", str(tmp_path / "p.toml"), "-o", str(output), "--ideal"]) == 0
    artifact = load(output)
    assert replay(artifact)[0] < 1e-9
    stiffnesses = [row["stiffness"] for row in artifact.margins]
    assert len(stiffnesses) >= 33
    assert set(Experiment.published("table-1").stiffness) <= set(stiffnesses)
    assert max(row["M_s"] for row in artifact.margins) <= 2.0
    assert main(["check", str(output)]) == 0
    assert "intact" in capsys.readouterr().out


def test_every_verb_has_help(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in VERBS:
        with pytest.raises(SystemExit) as stopped:
            main([verb, "--help"])
        assert stopped.value.code == 0
        out = capsys.readouterr().out
        assert "usage: jaxmpc" in out
        assert "?." not in out


def experiment_file(folder: Path, **changes: Any) -> str:
    """A short linear Table I of one's own."""
    plain = Experiment.published("table-1").to_dict() | {"name": "short", "duration": 8.0} | changes
    write_toml(folder / "short.toml", plain)
    return str(folder / "short.toml")


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Programs that XLA compiles meanwhile."""
    seen: list[str] = []

    def listen(event: str, seconds: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            seen.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seen
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.slow
def test_simulate_prints_its_tables_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["simulate", experiment_file(tmp_path), "--compare", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    told = capsys.readouterr().out
    for word in ("physics linear", "mpc-aob", "AOB alone", "MPC alone", "RMS of mpc-aob lower by", "peaks", "1.25"):
        assert word in told
    assert "Table I" not in told  # the paper's residuals belong to an arm
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["short-spectrum.png", "short.png"]


def test_unstable_controller_is_told_and_the_rest_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = experiment_file(tmp_path)
    assert main(["simulate", path, "--params", "printed", "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().out
    assert "1900 N/m: UNSTABLE, force out of bounds at 0.25 s: " in told
    assert any(f"peaks of the disturbance, {K_s} N/m" in told for K_s in (375, 810))  # the worst of the stable ones
    assert len(list((tmp_path / "out").iterdir())) == 2


@pytest.mark.slow
def test_of_a_moment_no_spectrum_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = experiment_file(tmp_path, duration=1.1, settle=1.0, reference={"z": -0.5})
    assert main(["simulate", path, "-o", str(tmp_path / "out")]) == 0
    assert "no spectrum of the disturbance: 0.1 s are scored" in capsys.readouterr().out


def test_where_nothing_is_stable_nothing_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = experiment_file(tmp_path, stiffness=[1900.0])
    assert main(["simulate", path, "--params", "printed", "-o", str(tmp_path / "out")]) == 1
    assert "figures: none" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_only_a_cascade_has_parts_to_compare_with() -> None:
    with pytest.raises(InputError, match="--compare"):
        comparison.parts(Params(architecture="aob"))
    alone = comparison.parts(Params(Khat_s=700.0))
    assert [p.architecture for p in alone.values()] == ["aob", "mpc"]
    assert float(alone["AOB alone"].Khat_s) == 700.0
    with pytest.raises(InputError, match=r"--compare = a family"):
        comparison.parts(Params.published("family"))


def test_reduction_and_deviation_are_those_of_the_numbers() -> None:
    """Against the formula, on residuals set by hand: half of each other's RMS, and the paper's own times 1.1."""
    experiment = Experiment.published("table-1")
    outcome = evaluate(Params(), experiment)
    paper = np.array([comparison.TABLE_1[K_s] for K_s in experiment.stiffness])
    true = {"true_peak_to_peak": 0.5 * paper[..., 0], "true_rms": paper[..., 1]}
    scaled = outcome.metrics._replace(peak_to_peak=0.8 * paper[..., 0], rms=1.1 * paper[..., 1], **true)
    ours = outcome._replace(metrics=scaled)
    rows = comparison.paper_rows(ours, experiment)
    assert [row[:2] for row in rows] == [[K_s, axis] for K_s in ("375", "810", "1900") for axis in "XYZ"]
    assert {(row[4], row[7]) for row in rows} == {("−20", "+10")}
    assert [row[8:] for row in rows] == [[f"{0.5 * pp:.2f}", f"{rms:.3f}"] for pp, rms in paper.reshape(-1, 2)]
    np.testing.assert_allclose(comparison.deviations(ours, experiment), 0.1)
    doubled = ours._replace(metrics=scaled._replace(rms=2.0 * scaled.rms, true_rms=4.0 * scaled.true_rms))
    assert {tuple(row[2:]) for row in comparison.reduction_rows(ours, {"other": doubled}, experiment)} == {
        ("+50", "+50", "+50", "+75", "+75", "+75")
    }


def test_other_experiments_stand_beside_no_table() -> None:
    for name in ("figure-3", "rhythm-steady"):
        experiment = Experiment.published(name)
        outcome: Any = None  # never looked at
        assert comparison.paper_rows(outcome, experiment) == []


def assert_second_run_compiles_nothing(experiment: Experiment) -> None:
    with compilations() as first:
        simulated(Params(), experiment, traced=True)
    with compilations() as second:
        simulated(Params(), without_motion(experiment), traced=True)
    assert len(first) > 0
    assert second == []


def test_heart_still_is_served_by_the_program_of_heart_moving() -> None:
    """A length of its own, so that no other test has compiled it before."""
    base = Experiment.published("table-1").to_dict()
    assert_second_run_compiles_nothing(Experiment.from_dict(base | {"duration": 6.123}))


def test_second_run_traces_nothing_and_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second process is one whose programs have all been forgotten; the first kept them where the command does."""
    use_all_cores()
    monkeypatch.setattr(store, "_folder", tmp_path / "traced")
    experiment = Experiment.from_toml(experiment_file(tmp_path))
    modules = evaluation, stability, synthesis
    programs = [
        (module, name) for module in modules for name, value in vars(module).items() if isinstance(value, JitOnce)
    ]

    def forget() -> None:
        for module, name in programs:
            program = getattr(module, name)
            monkeypatch.setattr(module, name, JitOnce(program._function, program._static))

    forget()
    first = with_heart_still(Params(), experiment)
    monkeypatch.setattr(store, "_traced", None)
    forget()
    second = with_heart_still(Params(), experiment)
    jax.tree.map(np.testing.assert_array_equal, second, first)
    kept = {name: [*getattr(module, name)._kept.values()] for module, name in programs}
    assert {name for name, found in kept.items() if found} >= {"_design", "_block", "_run", "_outcome"}
    assert all(one is not None for found in kept.values() for one in found)


@pytest.mark.slow
def test_heart_still_is_served_by_the_program_of_heart_moving_on_the_arm() -> None:
    base = Experiment.published("rhythm-steady").to_dict()
    assert_second_run_compiles_nothing(Experiment.from_dict(base | {"duration": 6.123}))


@pytest.mark.slow
def test_table_1_on_the_arm_is_near_the_papers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A calibration: the friction was chosen so; the limit is what it was chosen for."""
    assert main(["simulate", "table-1-wam", "-o", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "beside the paper's Table I" in told
    worst = float(told.partition("worst cell ")[2].partition(" %")[0])
    assert worst <= 25.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table-1-wam-spectrum.png", "table-1-wam.png"]


@pytest.mark.slow
def test_lost_contact_says_when(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "contact-loss", "-o", str(tmp_path)]) == 1
    assert "810 N/m: LOST_CONTACT at 14." in capsys.readouterr().out


def test_film_shows_the_run_at_the_row_asked_for(tmp_path: Path) -> None:
    """From a trace made by hand; JAX runs already, and its warning about forks must not stop the encoder."""
    pytest.importorskip("imageio_ffmpeg")
    experiment = Experiment.from_dict(
        Experiment.published("rhythm-steady").to_dict() | {"duration": 0.1, "settle": 0.0, "reference": {"z": -1.0}}
    )
    outcome = evaluate(Params(), Experiment.from_toml(experiment_file(tmp_path)))
    lost, steps = np.full((1, 3, experiment.steps), np.nan), experiment.steps
    force = np.concatenate([lost, np.zeros((1, 3, steps)), lost])
    q = np.tile(np.array(experiment.arm.resting())[:, None], (3, 1, steps))
    sample = ArmSample(force, force[..., None], force, force, force, force, force, q, q)
    path = tmp_path / "films" / "a.mp4"
    try:
        film(path, experiment, outcome._replace(trace=sample), 1)
    except InputError as error:
        if error.key != "MUJOCO_GL":
            raise
        pytest.skip(str(error))
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, check=True, capture_output=True).stdout
    width, height = SIZE
    frames = np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3).astype(int)
    # 0.1 s at 30 a second, the first and the last among them.
    assert len(frames) == 3
    red, green, blue = frames[..., : width // 2, :].transpose(3, 0, 1, 2)
    heart, arm = (red > 90) & (red > 1.8 * green) & (red > 1.8 * blue), np.minimum(np.minimum(red, green), blue) > 215
    assert (heart.sum(axis=(1, 2)) > 2000).all()
    assert (arm.sum(axis=(1, 2)) > 2000).all()


def test_a_key_that_is_no_letter_is_one_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a terminal's bytes are held to UTF-8, one that is none would end the thread that listens for Enter."""
    keys = io.TextIOWrapper(io.BytesIO(b"\xe9\n\n"), encoding="utf-8", errors="strict")
    monkeypatch.setattr(sys, "stdin", keys)
    assert main(["list"]) == 0
    assert list(keys) == ["\ufffd\n", "\n"]


def test_xla_is_silenced_before_a_verb_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    """`tune` and `trials` import JAX with their package, and it reads the level only then."""
    levels = []

    def look(name: str) -> Any:
        levels.append(os.environ.get("TF_CPP_MIN_LOG_LEVEL"))
        raise KeyboardInterrupt

    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    monkeypatch.setattr("jaxmpc.cli.import_module", look)
    assert main(["trials", "text"]) == 130
    assert levels == ["3"]


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_who_closes_the_outputs_loses_words_alone(closed: str) -> None:
    command = ["bash", "-c", f'"$@" {closed}', "-", sys.executable, "-m", "jaxmpc"]
    for words, code in (["list"], 0), (["lst"], 2):
        ran = subprocess.run([*command, *words], cwd=ROOT, capture_output=True, text=True, check=False)
        assert ran.returncode == code
        assert "Traceback" not in ran.stdout + ran.stderr
