"""Which values of an experiment go together, wherever it was built."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from jaxmpc.experiment.reference import Reference
from jaxmpc.experiment.tables import RESOLVED, ArmSettings, SensorSettings, TissueSettings
from jaxmpc.files.errors import InputError, plain_name
from jaxmpc.files.toml import without_arrays
from jaxmpc.law.momentum_observer import fastest
from jaxmpc.world.cable import fastest_stable
from jaxmpc.world.heart.motion import Motion

TABLES: Mapping[str, type[msgspec.Struct]] = MappingProxyType(
    {"motion": Motion, "reference": Reference, "sensor": SensorSettings, "tissue": TissueSettings, "arm": ArmSettings}
)
"""Tables of an experiment, by their names."""


def check_kinds(experiment: Any) -> None:
    """Refuse tables that are of another kind, and stiffnesses that are no sequence: only in Python may they be.

    Raises:
        InputError: Names the key, its value, what it must be and the remedy.
    """
    for name, kind in TABLES.items():
        if not isinstance(table := getattr(experiment, name), kind):
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            remedy = "`Experiment.from_dict` takes tables for them."
            raise InputError(name, table, f"{article} {kind.__name__}", remedy)
    if not isinstance(experiment.stiffness, tuple | list) and np.ndim(experiment.stiffness) != 1:
        raise InputError("stiffness", experiment.stiffness, "a tuple of numbers [N/m]", "Write (810.0,) for one.")


def tuple_of_floats(given: Any) -> tuple[Any, ...]:
    """Numbers as floats, whatever sequence they come in, so that experiments that say the same are equal."""
    return tuple(float(K) if type(K) is int else K for K in without_arrays(given))


def check_together(experiment: Any) -> None:
    """Refuse values that do not go together.

    Raises:
        InputError: Names the key, its value, what it must be and the remedy.
        TypeError: A value is of another type than its file's.
        AttributeError: The same.
    """
    plain_name("name", experiment.name)
    if not experiment.stiffness:
        raise InputError("stiffness", "[]", "at least one stiffness [N/m]", "The paper has [375.0, 810.0, 1900.0].")
    if experiment.duration <= 0.5 * experiment.sampling_time:
        bound = f"at least a sample (sampling_time = {experiment.sampling_time:g} s)"
        raise InputError("duration", experiment.duration, bound, "Raise duration or sample faster.")
    if experiment.settle >= experiment.duration:
        remedy = "Lower settle or raise duration."
        raise InputError("settle", experiment.settle, f"below duration (= {experiment.duration:g} s)", remedy)
    if (experiment.motion.kind == "recording") != bool(experiment.motion.file):
        remedy = 'Give both motion.kind = "recording" and motion.file = "…", or neither.'
        raise InputError("motion.file", experiment.motion.file or "missing", "given for a recording only", remedy)
    if experiment.physics == "mjx" and (experiment.arm.substeps > 1 or experiment.arm.cable_hz):
        remedy = 'Set arm.substeps = 1 and arm.cable_hz = 0, or physics = "wam".'
        raise InputError("physics", "mjx", "used without substeps and cable mode", remedy)
    if experiment.physics == "mjx" and experiment.arm.integrator != "euler":
        remedy = 'Set arm.integrator = "euler", which is MuJoCo\'s.'
        raise InputError("arm.integrator", experiment.arm.integrator, '"euler" on stock MJX', remedy)
    resolved = RESOLVED * experiment.arm.substeps / max(1.0, experiment.sampling_time / 1e-3)
    if experiment.physics == "wam" and experiment.arm.cable_hz > resolved * (1.0 + 1e-9):
        bound = (
            f"at most {resolved:g} Hz with arm.substeps = {experiment.arm.substeps} in {experiment.sampling_time:g} s"
        )
        raise InputError("arm.cable_hz", experiment.arm.cable_hz, bound, "Raise arm.substeps.")
    if experiment.physics == "wam" and experiment.arm.cable_hz:
        _check_cable(experiment.arm, experiment.sampling_time)
    if experiment.physics != "linear":
        _check_observer(experiment.arm, experiment.sampling_time, experiment.delay)


def _check_cable(arm: ArmSettings, T_s: float) -> None:
    """Refuse cables that would swing by the numbers alone: the controller would be blamed for it."""
    below = fastest_stable(arm.resting(), arm.tool_mass, arm.cable_damping, T_s / arm.substeps)
    if arm.cable_hz >= below:
        steps = f"arm.substeps = {arm.substeps} and arm.cable_damping = {arm.cable_damping:g}"
        bound = f"within what steps bear, a cable mode below {below:.4g} Hz with {steps} in this posture"
        raise InputError("arm.cable_hz", arm.cable_hz, bound, "Raise arm.substeps or lower arm.cable_damping.")


def _check_observer(arm: ArmSettings, T_s: float, delay: int) -> None:
    """Refuse an observer that would swing by itself: no margin of the loop knows of it."""
    most = fastest(T_s, delay)
    if arm.momentum_observer > most * (1.0 + 1e-9):
        bound = f"at most {most:g} rad/s at a sampling time of {T_s:g} s and a delay of {delay}"
        raise InputError("arm.momentum_observer", arm.momentum_observer, bound, "Lower it or sample faster.")
