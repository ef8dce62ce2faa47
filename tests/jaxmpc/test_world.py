"""Signals of an experiment and its file: what is put in is what the loop meets."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, InputError
from jaxmpc.experiment.reference import Hold, Ramp, Sweep, wanted_force
from jaxmpc.world.quantise import quantise


def test_motion_begins_smoothly() -> None:
    experiment = Experiment.published("figure-3")
    moved = experiment.signals.heart
    assert not moved[:5000].any()
    # An acceleration beyond a few times the template's 1.9 m/s² would be a force spike of our own making.
    assert np.abs(np.diff(moved, 2, axis=0)).max() / 1e-6 < 8.0


def test_reference_of_figure_3() -> None:
    wanted = Experiment.published("figure-3").signals.force_ref[:, 2]
    assert [wanted[k] for k in (0, 500, 1000, 2000, 4500, 9000, 24999)] == pytest.approx(
        [0, 1, 2, 0, -5, -5, -5], abs=1e-9
    )
    sweep = wanted[9500:19500] + 5.0
    assert np.abs(sweep).max() == pytest.approx(2.0, abs=1e-3)
    crossings = np.flatnonzero(np.diff(np.sign(sweep))) * 1e-3
    assert np.diff(crossings)[0] > 1.5
    assert np.diff(crossings)[-1] == pytest.approx(0.5, abs=0.05)


def test_ramps_are_marked_and_holds_run_to_the_end() -> None:
    force, ramps = wanted_force((Ramp(to=2.0, rate=1.0), Hold()), np.arange(0.0, 10.0, 0.1))
    assert force[-1] == 2.0
    assert ramps.sum() == 20
    force, ramps = wanted_force((Sweep(1.0, 1.0, 1.0, 2.0),), np.arange(0.0, 2.0, 0.01))
    np.testing.assert_allclose(force, np.sin(2 * np.pi * np.arange(0.0, 2.0, 0.01)), atol=1e-9)


def test_score_leaves_out_settling_and_ramps() -> None:
    score = Experiment.published("figure-3").signals.score
    assert not score[:5000].any()
    assert score[5000:].all()


def test_noise_has_its_size_and_its_seed() -> None:
    experiment = Experiment.published("table-1")
    assert experiment.signals.noise.std() == pytest.approx(0.010, rel=0.02)
    assert not np.allclose(experiment.signals.noise, experiment.with_seed(1).signals.noise)


def test_quantiser_rounds_half_up() -> None:
    levels = [quantise(x, 0.5, np) for x in (-0.26, -0.25, 0.24, 0.25, 0.74)]
    assert levels == [-0.5, 0.0, 0.0, 0.5, 0.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stifness = [810.0]", ["e.toml:1", "stifness", "Did you mean 'stiffness'"]),
        ("stiffness = [375.0, -1.0]", ["e.toml:1", "stiffness[1] = -1.0", "> 0.0"]),
        ("stiffness = []", ["at least one"]),
        ("duration = nan", ["e.toml:1", "duration = nan"]),
        ("duration = inf", ["e.toml:1", "duration = inf"]),
        ("duration = 4.0\nsettle = 4.0", ["e.toml:2", "settle", "below duration"]),
        ("delay = 3", ["e.toml:1", "delay = 3", "<= 2"]),
        ("duration = 1.0\nduration = 2.0", ["e.toml:2", "Cannot overwrite"]),
        ("[motion]\nsale = 2.0", ["e.toml:2", "motion.sale", "Did you mean 'scale'"]),
        ("[sensor]\nnoise = -0.1", ["e.toml:2", "sensor.noise = -0.1"]),
        ('[motion]\nkind = "recording"', ["e.toml", "motion.file"]),
        ('[motion]\nkind = "recording"\nfile = "gone.csv"', ["e.toml:3", "gone.csv", "No such file"]),
        ('[reference]\nz = [{ kind = "ramp", to = 1.0 }]', ["e.toml:2", "rate"]),
    ],
)
def test_wrong_experiment_is_refused_with_file_line_key_and_remedy(tmp_path: Path, text: str, words: list[str]) -> None:
    (tmp_path / "e.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        Experiment.from_toml(tmp_path / "e.toml")
    for word in words:
        assert word in str(caught.value)


def test_unknown_published_experiment_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="table-1"):
        Experiment.published("table-2")


def test_plain_data_of_an_experiment_makes_it_again() -> None:
    experiment = Experiment.published("figure-3")
    assert Experiment.from_dict(msgspec.json.decode(msgspec.json.encode(experiment.to_dict()))) == experiment
