"""`jaxmpc simulate`: what it prints, compares and draws."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, evaluate
from jaxmpc.cli import comparison, main
from jaxmpc.loop.arm import ArmSample
from jaxmpc.pictures.film import SIZE, film
from tests.jaxmpc.short_table import experiment_file


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
