"""The published experiments: all load, and each is what its name says."""

import tomllib
from collections.abc import Callable
from importlib import resources
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, evaluate
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment import SensorSettings
from jaxmpc.experiment.tables import ArmSettings, Change, TissueSettings, softening
from jaxmpc.world.heart import rhythm, ventilation
from jaxmpc.world.heart.motion import displacement

FOLDER = resources.files("jaxmpc.experiment") / "published"
NAMES = sorted(entry.name.removesuffix(".toml") for entry in FOLDER.iterdir())
SCENARIOS = {
    "A": "rhythm-steady",
    "B": "rhythm-variability",
    "C": "rhythm-rate-step",
    "D": "rhythm-premature",
    "D in bursts": "rhythm-bigeminy",
    "E": "rhythm-fibrillation",
    "F": "ventilator-hold",
    "F cough": "cough",
    "G": "amplitude-drift",
    "H": "tissue-swap",
    "I": "contact-loss",
    "J": "figure-3-wam",
}
PUBLISHED_COULOMB = np.array([[2.7, 2.5, 1.5, 1.1], [1.6, 0.53, 0.35, 0.63]])


def written(name: str) -> dict[str, Any]:
    return tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def onsets(experiment: Experiment) -> np.ndarray:
    """Beats that begin in the scored part of a run [s]."""
    found = rhythm.beats(experiment.motion, experiment.duration).onsets
    return found[(found > experiment.settle) & (found < experiment.duration)]


@pytest.mark.parametrize("name", NAMES)
def test_published_experiment_loads(name: str) -> None:
    experiment = Experiment.published(name)
    assert experiment.name == name
    assert experiment.signals.score.any(axis=0).all()
    assert np.isfinite(experiment.signals.heart).all()
    assert Experiment.from_dict(msgspec.json.decode(msgspec.json.encode(experiment.to_dict()))) == experiment


@pytest.mark.parametrize("name", NAMES)
def test_units_stand_beside_numbers(name: str) -> None:
    """A physical key is no key without its unit: each of these lines says one."""
    lines = (FOLDER / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    physical = ("duration", "settle", "stiffness", "noise", "lsb", "_hz", "_at", "start", "coulomb", "viscous", "_mass")
    bare = [line for line in lines if line.partition(" =")[0].endswith(physical) and "[" not in line.partition("#")[2]]
    assert bare == []


def test_every_scenario_is_published() -> None:
    assert set(SCENARIOS.values()) <= set(NAMES)
    arm = {"figure-3-wam", "table-1-wam", "family-wam", *SCENARIOS.values()}
    assert {name for name in NAMES if Experiment.published(name).physics == "wam"} == arm


def test_nominal_arm_is_written_out_in_full() -> None:
    """Every key stands in the file, but for those that posture, true friction and damping say."""
    data = written("table-1-wam")
    none = {"target", "nominal_coulomb", "nominal_viscous", "nominal_presliding", "lowpass_hz"}
    for key, kind in (("sensor", SensorSettings), ("tissue", TissueSettings), ("arm", ArmSettings)):
        assert set(data[key]) == {field.name for field in msgspec.structs.fields(kind)} - none
    assert {"delay", "velocity_lowpass", "damping", "sampling_time"} <= set(data)


def test_nominal_arm_is_that_of_the_definitions() -> None:
    experiment = Experiment.published("table-1-wam")
    arm, sensor = experiment.arm, experiment.sensor
    assert (experiment.physics, experiment.delay, experiment.damping) == ("wam", 1, "sampled")
    assert experiment.velocity_lowpass == 180.0
    assert arm.posture == (0.0, 0.7, 0.0, 2.2)
    assert (arm.tool_mass, arm.mass_error, arm.encoder_counts, arm.cable_hz) == (0.3, -0.1, 4096, 0.0)
    assert (sensor.noise, sensor.lsb, sensor.kalman) == (0.01, (0.0061, 0.0061, 0.0122), 0.0)
    assert experiment.loop_path().sensor_cutoff == pytest.approx(2.0 * np.pi * 500.0)
    assert arm.coulomb == pytest.approx(np.array([0.75, 0.9, 0.75, 0.6]) * PUBLISHED_COULOMB[0])
    assert (arm.coulomb >= PUBLISHED_COULOMB.min(axis=0)).all()
    assert (arm.coulomb <= PUBLISHED_COULOMB.max(axis=0)).all()
    assert arm.torque_lsb == 1.0 / 2700.0


def test_other_experiments_have_the_same_arm() -> None:
    nominal = Experiment.published("table-1-wam")
    for name in SCENARIOS.values():
        experiment = Experiment.published(name)
        assert (experiment.arm, experiment.sensor) == (nominal.arm, nominal.sensor), name
        assert (experiment.delay, experiment.velocity_lowpass) == (nominal.delay, nominal.velocity_lowpass), name


def test_arm_and_linear_loop_ask_the_same_of_a_controller() -> None:
    for name in ("table-1", "figure-3"):
        linear, arm = Experiment.published(name), Experiment.published(f"{name}-wam")
        for one, other in zip(linear.signals, arm.signals, strict=True):
            np.testing.assert_array_equal(one, other)
        assert linear.stiffness == arm.stiffness


def test_scenarios_of_rhythm_share_one_program() -> None:
    """They differ in data alone, so what one compiles serves the others."""
    others = ("rhythm-steady", "rhythm-bigeminy", "ventilator-hold", "cough", "amplitude-drift")
    nominal = Experiment.published("table-1-wam")
    for experiment in map(Experiment.published, others):
        assert program_spec(experiment) == program_spec(nominal)
        shapes = ([np.shape(leaf) for leaf in scenario_data(e).signals] for e in (experiment, nominal))
        assert next(shapes) == next(shapes)


def moved(name: str) -> tuple[Experiment, np.ndarray, np.ndarray]:
    """An experiment, its times and the heart's displacement."""
    experiment = Experiment.published(name)
    t = np.arange(experiment.steps) * experiment.sampling_time
    return experiment, t, displacement(experiment.motion, t)[0]


def test_rhythms_do_what_their_names_say_within_the_run() -> None:
    """Each event lies between the settling and the end; what is drawn is drawn so by the file's seed."""
    steady = np.diff(onsets(Experiment.published("rhythm-steady")))
    np.testing.assert_allclose(steady, 1.0 / 1.265, rtol=1e-9)
    varied = np.diff(onsets(Experiment.published("rhythm-variability")))
    assert 0.005 < varied.std() / varied.mean() < 0.1
    step = np.diff(onsets(Experiment.published("rhythm-rate-step")))
    np.testing.assert_allclose(step[[0, -1]], [1.0, 60.0 / 110.0], rtol=1e-6)
    for name, fewest in (("rhythm-premature", 1), ("rhythm-bigeminy", 4)):
        early = np.diff(onsets(Experiment.published(name))) < 0.8 / 1.265
        assert early.sum() >= fewest, name
    assert np.std(np.diff(onsets(Experiment.published("rhythm-fibrillation")))) > 0.1


def test_ventilation_stops_and_starts_again() -> None:
    experiment, t, _ = moved("ventilator-hold")
    rate = ventilation.respiratory_phase(experiment.motion, t)[1]
    held = (t > 9.0) & (t < 17.0)
    assert np.abs(rate[held]).max() < 1e-9
    assert rate[(t > 20.0)].min() > 0.3


def test_a_cough_is_10_mm() -> None:
    experiment, t, position = moved("cough")
    calm = msgspec.structs.replace(experiment.motion, ventilation="steady", ventilation_at=10.0)
    away = np.linalg.norm(position - displacement(calm, t)[0], axis=1)
    assert away.max() == pytest.approx(0.010, rel=1e-3)
    assert experiment.settle < t[away > 1e-3][0] < t[away > 1e-3][-1] < experiment.duration


def test_tissue_is_swapped_from_300_to_1200() -> None:
    experiment, t, _ = moved("tissue-swap")
    stiffness = experiment.stiffness[0] * softening(experiment.tissue, t)
    assert (stiffness[0], stiffness[-1]) == (300.0, pytest.approx(1200.0))
    changing = t[(stiffness > 300.1) & (stiffness < 1199.9)]
    assert changing[0] > experiment.settle
    assert np.ptp(changing) == pytest.approx(0.2, abs=0.01)


def test_contact_may_be_lost_only_where_it_is_meant_to_be() -> None:
    assert [name for name in NAMES if not Experiment.published(name).tissue.attached] == ["contact-loss"]


WRONG: dict[str, dict[str, Any]] = {
    "damping": {"damping": "Ideal"},
    "settle": {"settle": -5.0},
    "duration": {"duration": float("nan")},
    "stiffness[0]": {"stiffness": (-810.0,)},
    "sensor.noise": {"sensor": SensorSettings(noise=-0.01)},
    "arm.encoder_counts": {"physics": "wam", "arm": ArmSettings(encoder_counts=-4096)},
    "arm.substeps": {"physics": "wam", "arm": ArmSettings(substeps=0)},
}


@pytest.mark.parametrize("key", WRONG)
def test_what_is_built_in_python_meets_the_bounds_of_its_file(key: str) -> None:
    values = {"duration": 3.0, "settle": 1.0, **WRONG[key]}
    with pytest.raises(InputError) as refused:
        evaluate(Params(), Experiment(**values))
    read = {name: msgspec.to_builtins(value) for name, value in values.items()}
    with pytest.raises(InputError) as of_file:
        Experiment.from_dict(read)
    assert refused.value.key == key
    assert f"{refused.value}" == f"{of_file.value}"


@pytest.mark.parametrize(("key", "value"), [("name", 3), ("duration", "long"), ("motion", 3), ("arm", "stiff")])
def test_values_of_another_type_are_told_by_their_key(key: str, value: Any) -> None:
    with pytest.raises(InputError) as refused:
        Experiment(**{"physics": "wam", key: value})
    assert refused.value.key == key


@pytest.mark.parametrize("key", ["motion", "reference", "sensor", "tissue", "arm"])
@pytest.mark.parametrize("value", [{}, {"seed": 3}, None, 3, Change(1.0, 2.0)], ids=str)
def test_tables_that_are_built_in_python_are_of_their_kind(key: str, value: Any) -> None:
    with pytest.raises(
        InputError, match=rf"^{key} = .*: must be an? {key.capitalize()}.*`Experiment\.from_dict` takes"
    ):
        Experiment(**{key: value})


@pytest.mark.parametrize(
    ("build", "key"),
    [
        (lambda: ArmSettings(cable_hz="fast"), "arm.cable_hz"),
        (lambda: ArmSettings(beyond_sensor=None), "arm.beyond_sensor"),
        (lambda: TissueSettings(kind=["elastic"]), "tissue.kind"),
        (lambda: TissueSettings(changes=3), "tissue.changes"),
        (lambda: TissueSettings(changes=({"at": 1.0, "factor": 2.0},)), "tissue.changes"),
        (lambda: Experiment(stiffness=810.0), "stiffness"),
        (lambda: Experiment(stiffness=np.array(810.0)), "stiffness"),
        (lambda: Experiment(stiffness=np.eye(2)), "stiffness"),
    ],
)
def test_values_of_a_table_that_are_of_another_type_are_told_by_their_key(build: Callable[[], Any], key: str) -> None:
    with pytest.raises(InputError) as refused:
        build()
    assert refused.value.key == key


def test_bounds_are_met_once_and_by_numbers_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(duration=np.float64(1.0), settle=0.2, stiffness=(np.float64(810.0),))
    scenario_data(experiment)
    monkeypatch.setattr("jaxmpc.files.toml.convert", None)
    scenario_data(experiment)
