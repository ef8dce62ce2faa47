"""Twin's settings from an experiment or the name of a rhythm: it meets what the simulation meets."""

from importlib import resources
from pathlib import Path
from typing import Any, get_args, get_type_hints

from msgspec import Struct
from msgspec.structs import replace

from deploy.twin.settings import TwinSettings
from jaxmpc.experiment.tables import ArmSettings, SensorSettings, TissueSettings
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.toml import convert, known_keys, located, meant, read_toml
from jaxmpc.world.heart.motion import Motion

HEARTS = ("harmonics", "none")
"""Kinds of motion that need no more than their name."""
RHYTHMS: tuple[str, ...] = get_args(get_type_hints(Motion)["rhythm"])
SCENARIOS = ("ventilator-hold", "cough", "amplitude-drift")
"""Published experiments that are named after what their heart or lungs do."""

ARM = ("tool_mass", "beyond_sensor", "coulomb", "viscous", "presliding")
"""Fields that the arm of an experiment and the twin have alike."""
SIMULATED = ("cable_hz", "encoder_counts", "torque_lsb", "torque_limit")
"""Fields of the arm that the twin has not: its cables are rigid, its drives those of its pucks."""
SENSOR = ("noise", "lsb", "lowpass_hz")
"""Such fields of the force sensor."""


def motion_named(name: str, seed: int = 0) -> Motion:
    """The seven peaks of the paper's Fig. 4, a heart at rest, a rhythm, a published scenario's motion, or a recording.

    Args:
        name: One of `HEARTS`, `RHYTHMS` and `SCENARIOS`; or a file, `heart.csv`, of millimetres `heart.csv:mm`, which
            repeats.
        seed: What all that is drawn comes from.

    Raises:
        InputError: There is no such name.
    """
    file, _, unit = name.partition(":")
    if file.endswith((".csv", ".npz")):
        found = {"kind": "recording", "file": file, "unit": unit or "m", "repeat": True}
        return convert(found, Motion, "motion")
    _one_of("rhythm", name, (*HEARTS, *RHYTHMS, *SCENARIOS))
    if name in HEARTS:
        return convert({"kind": name}, Motion, "motion")
    motion = {"kind": "rhythm", "rhythm": name}
    if name in SCENARIOS:
        motion = read_toml(_published(name))["motion"]
    return convert(motion | {"seed": seed}, Motion, "motion")


def twin_settings(
    experiment: str | None = None,
    *,
    stiffness: float | None = None,
    tissue: str | None = None,
    touching: bool = False,
    rhythm: str | None = None,
    delay: int | None = None,
    seed: int = 0,
    **others: Any,
) -> TwinSettings:
    """Settings of a twin, from an experiment and from what is said beside it.

    Args:
        experiment: A TOML file, or the name of a published experiment; its first stiffness is taken.
        stiffness: Another one [N/m].
        tissue: Kind of another tissue.
        touching: Whether the tissue does not hold the tip.
        rhythm: Name of another motion; see `motion_named`.
        delay: Another one, from a torque frame to its action [samples].
        seed: What noise, faults and the motion of that name are drawn from.
        **others: Further fields of `TwinSettings`.

    Raises:
        InputError: The experiment cannot be read, or a value is wrong.
    """
    settings = _of_experiment(experiment) if experiment is not None else {}
    table: TissueSettings = settings.get("tissue", TissueSettings())
    if tissue is not None:
        table = convert({"kind": tissue}, TissueSettings, "tissue")
    settings["tissue"] = replace(table, attached=False) if touching else table
    if rhythm is not None:
        settings["motion"] = motion_named(rhythm, seed)
    if stiffness is not None:
        settings["stiffness"] = stiffness
    if delay is not None:
        settings["delay"] = delay
    return TwinSettings(**settings, seed=seed, **others)


def unlike_the_simulation(experiment: str | None, rhythm: str | None) -> list[str]:
    """Sentences on what the twin does otherwise than the experiment, or than a recording named beside it, says."""
    found = []
    data = read_toml(_file_of(experiment)) if experiment is not None else {}
    motion = data.get("motion", {}) if rhythm is None else {}
    if rhythm is not None and motion_named(rhythm).kind == "recording":
        found.append(
            f"the twin, which has no end, repeats {rhythm}, faded to rest over 0.5 s at both ends with 1 s between"
        )
    if motion.get("kind") == "recording" and not motion.get("repeat", False):
        found.append(
            f"{experiment} plays {motion['file']} once; the twin, which has no end, repeats it, faded to rest at both "
            "ends with a rest between: set motion.repeat = true, and the simulation does so too"
        )
    arm = convert(data.get("arm", {}), ArmSettings, "arm")
    changed = {key: getattr(arm, key) for key in SIMULATED if getattr(arm, key) != getattr(ArmSettings(), key)}
    if changed:
        told = ", ".join(f"arm.{key} = {value}" for key, value in changed.items())
        found.append(f"NOT IN THE TWIN, whose cables are rigid and whose drives are its pucks': {told}")
    return found


EXPERIMENT = (
    *("name", "physics", "damping", "duration", "settle", "stiffness", "sampling_time", "delay", "force_limit"),
    *("velocity_lowpass", "motion", "reference", "sensor", "tissue", "arm"),
)
"""Keys of an experiment's file, written out here: `jaxmpc.experiment.Experiment`, which has them, needs JAX."""


class _Loop(Struct):
    """What of an experiment stands in no table."""

    stiffness: tuple[float, ...] = ()
    delay: int = 1


def _of_experiment(name: str) -> dict[str, Any]:
    """Settings of the world in an experiment; of the controller's share in it the twin knows nothing."""
    path = _file_of(name)
    data = read_toml(path)
    with located(path):
        for key, value in data.items():
            if key not in EXPERIMENT:
                remedy = meant(data, EXPERIMENT) or nearest(key, list(EXPERIMENT))
                raise InputError(key, value, "a known key", remedy)
        arm: ArmSettings = _table(data, "arm", ArmSettings)
        tissue: TissueSettings = _table(data, "tissue", TissueSettings)
        motion: Motion = _table(data, "motion", Motion)
        if motion.file:
            # A flight has no end that a recording could be long enough for: it rests for a second and begins again.
            motion = replace(motion, file=str(path.parent / motion.file), repeat=True)
        settings: dict[str, Any] = {"tissue": tissue, "motion": motion, "posture": arm.resting()}
        settings |= {key: getattr(arm, key) for key in ARM}
        sensor: SensorSettings = _table(data, "sensor", SensorSettings)
        settings |= {key: getattr(sensor, key) for key in SENSOR if key in data.get("sensor", {})}
        loop = convert({key: data[key] for key in ("stiffness", "delay") if key in data}, _Loop, "")
        settings |= {"stiffness": loop.stiffness[0]} if loop.stiffness else {}
        return settings | ({"delay": loop.delay} if "delay" in data else {})


def _file_of(experiment: str) -> Path:
    """A path as it is, else the file of that published experiment."""
    path = Path(experiment)
    return path if experiment.endswith(".toml") or "/" in experiment or path.is_file() else _published(experiment)


def _table(data: dict[str, Any], key: str, kind: Any) -> Any:
    table = data.get(key, {})
    if isinstance(table, dict):
        known_keys(kind, table, key)
    return convert(table, kind, key)


def _one_of(key: str, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise InputError(key, name, "a known name", nearest(name, list(known)))


def _published(name: str) -> Path:
    """The file of a published experiment; its package is installed as files."""
    folder = Path(str(resources.files("jaxmpc.experiment"))) / "published"
    known = sorted(path.stem for path in folder.glob("*.toml"))
    if name not in known:
        raise InputError("experiment", name, "a TOML file or a published experiment", nearest(name, known))
    return folder / f"{name}.toml"
