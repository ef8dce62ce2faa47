"""What may be swept: every parameter of the controller and every key of the experiment, by one name each."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import msgspec

from jaxmpc.experiment import Experiment, SensorSettings
from jaxmpc.experiment.reference import Reference
from jaxmpc.experiment.tables import ArmSettings, TissueSettings
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.quantities import PARAMETERS
from jaxmpc.synthesis.params import Params
from jaxmpc.world.heart.motion import Motion

COUNTED = ("disturbance_order", "designed_delay")
"""What of that is told by whole numbers."""
STRUCTURAL = ("architecture", *COUNTED, "guarded")
"""What of a controller is no number to be tuned and can be swept: each value is a program of its own."""
TABLES: Mapping[str, type[msgspec.Struct]] = MappingProxyType(
    {"motion": Motion, "reference": Reference, "sensor": SensorSettings, "tissue": TissueSettings, "arm": ArmSettings}
)
UNITS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("duration", "settle", "sampling_time", "motion.start", "motion.fade"), "s"),
        **dict.fromkeys(("force_limit", "sensor.noise", "sensor.lsb"), "N"),
        **dict.fromkeys(("reference.x", "reference.y", "reference.z"), "N"),
        **dict.fromkeys(("arm.tool_mass", "arm.tool_mass_error", "arm.beyond_sensor"), "kg"),
        **dict.fromkeys(("arm.coulomb", "arm.nominal_coulomb", "arm.torque_lsb", "arm.torque_limit"), "N m"),
        **dict.fromkeys(("arm.joint_torque_limit", "arm.torque_step_limit"), "N m"),
        **dict.fromkeys(("arm.viscous", "arm.nominal_viscous"), "N m s/rad"),
        **dict.fromkeys(("arm.posture", "arm.presliding", "arm.nominal_presliding"), "rad"),
        **dict.fromkeys(("velocity_lowpass", "arm.momentum_observer"), "rad/s"),
        **dict.fromkeys(("sensor.lowpass_hz", "arm.cable_hz"), "Hz"),
        "stiffness": "N/m",
        "delay": "samples",
        "sensor.kalman": "N/s",
        "arm.target": "m",
        "motion.drift": "m/min",
    }
)
"""Units of the experiment's keys; one that is not here has none, or says its own in `jaxmpc.experiment`."""
RECORDING = "motion.file"
"""The key whose values are files, which count by their content."""
SIGNALS = ("motion.", "reference.", "sensor.noise", "sensor.seed", "settle", "duration", "sampling_time", "tissue.")
"""Beginnings of the keys on which the signals of a scene depend: the rest are numbers beside them."""
_SUBSTEPS = ("arm.substeps", "arm.integrator", "physics")


class Target(NamedTuple):
    """What an axis sets."""

    name: str
    table: Literal["params", "experiment"]
    unit: str

    @property
    def signals(self) -> bool:
        """Whether the signals of the world depend on it."""
        return self.table == "experiment" and self.name.startswith((*SIGNALS, *_SUBSTEPS))


OWN_FILTERS = {"velocity_lowpass": "velocity_cutoff", "sensor.kalman": "force_cutoff"}
"""Filters of the experiment, and the parameters by which a controller brings its own in their place."""


def known_names() -> list[str]:
    """Every name that an axis may have."""
    names = [*PARAMETERS, *STRUCTURAL]
    for field in msgspec.structs.fields(Experiment):
        inner = TABLES.get(field.name)
        if inner is not None:
            names += [f"{field.name}.{each.name}" for each in msgspec.structs.fields(inner)]
        elif field.name != "name":
            names.append(field.name)
    return names


def target(name: str) -> Target:
    """What an axis of this name sets; `arm.coulomb.2` is one entry of a vector.

    Raises:
        InputError: There is no such key.
    """
    if name in PARAMETERS:
        return Target(name, "params", PARAMETERS[name].unit)
    if name in STRUCTURAL:
        return Target(name, "params", "-")
    head, _, last = name.rpartition(".")
    # Of one name alone, since axes of two would set one entry twice.
    whole = head if numbered(last) and last == f"{int(last)}" else name
    if whole not in known_names() or whole in (*PARAMETERS, *STRUCTURAL):
        raise InputError(f"sweep.axes.{name}", "swept", "a known parameter or key", nearest(name, known_names()))
    return Target(name, "experiment", UNITS.get(whole, "-"))


def numbered(part: str) -> bool:
    """Whether a word is a plain number, of an entry or a row: in other scripts' digits, or of thousands, it is none."""
    return part.isascii() and part.isdecimal() and len(part) < 10


def read(name: str, params: Params, experiment: Mapping[str, Any]) -> Any:
    """The base's own value of an axis.

    Raises:
        InputError: It is an entry that the vector does not have.
    """
    if target(name).table == "params":
        value = getattr(params, name)
        return value.tolist() if hasattr(value, "tolist") else value
    found: Any = experiment
    for part in name.split("."):
        try:
            if isinstance(found, str):
                raise TypeError  # a word has letters, and no entries
            found = found[int(part)] if numbered(part) else found[part]
        except (IndexError, TypeError, KeyError):
            raise InputError(f"sweep.axes.{name}", part, "an entry that is there", "Count from 0.") from None
    return found


def changed(experiment: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The plain data of an experiment with some keys set; what is given stays as it is."""
    data = dict(experiment)
    for name, value in changes.items():
        _set(data, name.split("."), value)
    return data


def _set(data: Any, parts: list[str], value: Any) -> None:
    part, *rest = parts
    key: Any = int(part) if part.isdigit() else part
    if not rest:
        data[key] = value
        return
    inner = data[key]
    data[key] = list(inner) if isinstance(inner, list | tuple) else dict(inner)
    _set(data[key], rest, value)
