"""Heart motion, force reference and recordings: what is put in is what the loop meets."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import scipy.signal

from jaxmpc import Experiment, InputError
from jaxmpc.world import heart
from jaxmpc.world.contact import quantise
from jaxmpc.world.reference import Hold, Ramp, Sweep, wanted_force

T = np.arange(0.0, 40.0, 1e-3)


def test_harmonics_have_the_seven_peaks_of_the_paper() -> None:
    motion = heart.harmonic_motion(T)
    spectrum = np.abs(np.fft.rfft(motion[:, 2] * np.hanning(len(T))))
    peaks = scipy.signal.find_peaks(spectrum, height=0.02 * spectrum.max())[0]
    hertz = np.fft.rfftfreq(len(T), 1e-3)[peaks]
    np.testing.assert_allclose(hertz, [0.34, 0.72, 1.25, 2.53, 3.78, 5.08, 6.32], atol=0.05)


def test_harmonics_have_the_size_of_the_table() -> None:
    """RMS and peak to peak per axis as tabulated with the amplitudes."""
    motion = heart.harmonic_motion(np.arange(0.0, 600.0, 1e-3))
    np.testing.assert_allclose(1e3 * motion.std(axis=0), [1.40, 1.17, 2.75], rtol=0.02)
    np.testing.assert_allclose(1e3 * np.ptp(motion, axis=0), [7.4, 6.1, 14.3], rtol=0.05)


def test_phases_come_from_the_seed_alone() -> None:
    one, same, other = (heart.harmonic_motion(T, phase_seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert not np.allclose(one, other)
    assert one.std() == pytest.approx(other.std(), rel=0.05)


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
    levels = [quantise(x, 0.5, np.floor) for x in (-0.26, -0.25, 0.24, 0.25, 0.74)]
    assert levels == [-0.5, 0.0, 0.0, 0.5, 0.5]


def write_csv(path: Path, rows: np.ndarray, header: str = "t,x,y,z") -> Path:
    lines = [header, *(",".join(f"{cell:.9g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def recording(rate: float = 100.0, seconds: float = 4.0) -> np.ndarray:
    t = np.arange(0.0, seconds, 1.0 / rate)
    return np.column_stack([t, 3e-3 * np.sin(2 * np.pi * np.outer(t, [1.0, 2.0, 3.0]))])


def test_recording_is_played_with_continuous_acceleration(tmp_path: Path) -> None:
    times, values = heart.read_recording(write_csv(tmp_path / "r.csv", recording()))
    fine = np.arange(0.0, 3.9, 1e-3)
    played = heart.recorded_motion(fine, times, values, False, "r.csv")
    np.testing.assert_allclose(played[:, 1], 3e-3 * np.sin(4 * np.pi * fine) - 3e-3 * 0.0, atol=2e-5)
    acceleration = np.diff(played, 2, axis=0) / 1e-6
    assert np.abs(acceleration).max() < 1.2 * 3e-3 * (6 * np.pi) ** 2


def test_npz_and_millimetres_are_the_same_recording(tmp_path: Path) -> None:
    rows = recording()
    np.savez(tmp_path / "r.npz", t=rows[:, 0], x=1e3 * rows[:, 1], y=1e3 * rows[:, 2], z=1e3 * rows[:, 3])
    from_csv = heart.read_recording(write_csv(tmp_path / "r.csv", rows))
    from_npz = heart.read_recording(tmp_path / "r.npz", "mm")
    np.testing.assert_allclose(from_npz[1], from_csv[1], atol=1e-10)


def test_repeated_recording_rests_between(tmp_path: Path) -> None:
    times, values = heart.read_recording(write_csv(tmp_path / "r.csv", recording()))
    played = heart.recorded_motion(np.arange(0.0, 12.0, 1e-3), times, values, True, "r.csv")
    assert not played[4100:4900].any()
    np.testing.assert_allclose(played[1000:2000], played[1000 + 4990 : 2000 + 4990], atol=1e-3)


def damaged(kind: str) -> tuple[np.ndarray, str]:
    rows, header = recording(), "t,x,y,z"
    match kind:
        case "nan":
            rows[17, 2] = np.nan
        case "gap":
            rows = np.delete(rows, slice(100, 110), axis=0)
        case "backwards":
            rows[50, 0] = rows[48, 0]
        case "slow":
            rows = recording(rate=20.0)
        case "millimetres":
            rows[:, 1:] *= 1e3
        case "columns":
            header = "time,x,y,z"
        case "missing axis":
            rows, header = rows[:, :3], "t,x,y"
        case "short":
            rows = rows[:3]
    return rows, header


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("nan", ["r.csv:19", "y = nan", "finite"]),
        ("gap", ["r.csv:102", "a gap of 0.11 s"]),
        ("backwards", ["r.csv:52", "increasing"]),
        ("slow", ["20 Hz", "at least 50 Hz"]),
        ("millimetres", ["peak to peak", 'motion.unit = "mm"']),
        ("columns", ["r.csv:1", "time, x, y, z", "must be t, x, y, z"]),
        ("missing axis", ["r.csv:1", "t, x, y"]),
        ("short", ["rows = 3"]),
    ],
)
def test_damaged_recording_is_refused_with_its_place(tmp_path: Path, kind: str, words: list[str]) -> None:
    path = write_csv(tmp_path / "r.csv", *damaged(kind))
    (tmp_path / "e.toml").write_text('[motion]\nkind = "recording"\nfile = "r.csv"\nrepeat = true\n')
    with pytest.raises(InputError) as caught:
        Experiment.from_toml(tmp_path / "e.toml")
    for word in [*words, str(path)]:
        assert word in str(caught.value)


def test_recording_shorter_than_the_experiment_is_refused(tmp_path: Path) -> None:
    write_csv(tmp_path / "r.csv", recording())
    with pytest.raises(InputError, match="repeat = true"):
        Experiment.from_dict({"motion": {"kind": "recording", "file": "r.csv"}}, tmp_path)


def test_cell_that_is_no_number_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("t,x,y,z\n0,0,0,0\n0.01,zero,0,0\n")
    with pytest.raises(InputError, match=r"r\.csv:3"):
        heart.read_recording(tmp_path / "r.csv")


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
    with pytest.raises(InputError, match="figure-3, table-1"):
        Experiment.published("table-2")


def test_plain_data_of_an_experiment_makes_it_again() -> None:
    experiment = Experiment.published("figure-3")
    assert Experiment.from_dict(msgspec.json.decode(msgspec.json.encode(experiment.to_dict()))) == experiment
