"""What a sweep may vary and rank by: something that its runs depend on, and that they measure."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.quantities import AXES
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.structure import IDLE
from jaxmpc.world.tissue import LAWS
from sweeps.goal import ON_ARM, SWING
from sweeps.space import SweepSpace
from sweeps.targets import OWN_FILTERS

DAMPING_FILTERS = ("velocity_lowpass", "velocity_cutoff")
"""What only damping by a sampled velocity passes through."""
MOTION_DRAWN = frozenset(
    f"motion.{key}"
    for key in ("kind", "phases", "rhythm", "rr_variation", "heart_rate_drift", "amplitude_spread", "drift")
)
"""What decides whether a motion's seed draws anything."""


class Need(NamedTuple):
    """What must be so somewhere for a key of the experiment to have an effect."""

    key: str
    """That decides, or a table of such; where it or a part of it is swept too, it may be so."""
    holds: Callable[[Experiment], bool]
    where: str
    """In words, after "swept where"."""
    remedy: str


_MOVING = Need("motion.kind", lambda each: each.motion.kind != "none", "the heart moves", "Set motion.kind.")
_PHASED = Need(
    "motion.kind",
    lambda each: each.motion.kind in ("harmonics", "rhythm"),
    "the heart's motion has phases",
    'Set motion.kind = "harmonics" or "rhythm".',
)
_RECORDED = Need(
    "motion.kind",
    lambda each: each.motion.kind == "recording",
    "a recording is played",
    'Set motion.kind = "recording".',
)
_COMPENSATED = Need(
    "arm.compensation",
    lambda each: each.arm.compensation != 0.0,
    "friction is compensated by what is believed of it",
    "Set arm.compensation.",
)
_CABLED = Need("arm.cable_hz", lambda each: each.arm.cable_hz != 0.0, "cables have a mode", "Set arm.cable_hz.")
_STEPPING = Need(
    "motion.rhythm",
    lambda each: each.motion.rhythm == "rate-step",
    "the heart's rate steps",
    'Set motion.rhythm = "rate-step".',
)
_UNSTEPPING = Need(
    "motion.rhythm",
    lambda each: each.motion.rhythm != "rate-step",
    "the rhythm is no rate step, which has rates of its own",
    "Sweep motion.rate_step_hz.",
)
_VARIABLE = Need(
    "motion.rhythm",
    lambda each: each.motion.rhythm == "variability",
    "the heart's intervals vary by it",
    'Set motion.rhythm = "variability".',
)
_VENTILATED = Need(
    "motion.ventilation",
    lambda each: each.motion.ventilation != "steady",
    "the ventilator holds or the patient coughs",
    'Set motion.ventilation = "hold" or "cough".',
)
_HOLDING = Need(
    "motion.ventilation",
    lambda each: each.motion.ventilation == "hold",
    "the ventilator holds",
    'Set motion.ventilation = "hold".',
)
_CHANGING = Need(
    "reference",
    lambda each: any(isinstance(getattr(each.reference, axis), tuple) for axis in AXES),
    "the wanted force changes",
    "Give reference.z ramps or sweeps.",
)
_RUBBING = Need(
    "arm.coulomb",
    lambda each: any((*each.arm.coulomb, *(each.arm.nominal_coulomb or ()))),
    "a joint has Coulomb friction",
    "Give arm.coulomb.",
)
NEEDS: Mapping[str, Need] = MappingProxyType(
    {
        **dict.fromkeys(("motion.scale", "motion.start", "motion.fade"), _MOVING),
        "motion.phases": _PHASED,
        **dict.fromkeys(("motion.file", "motion.unit", "motion.repeat"), _RECORDED),
        **dict.fromkeys(("arm.nominal_coulomb", "arm.nominal_viscous", "arm.nominal_presliding"), _COMPENSATED),
        "arm.cable_damping": _CABLED,
        **dict.fromkeys(("motion.rate_step_at", "motion.rate_step_hz"), _STEPPING),
        "motion.heart_rate_hz": _UNSTEPPING,
        **dict.fromkeys(("motion.rr_variation", "motion.sinus_arrhythmia", "motion.heart_rate_drift"), _VARIABLE),
        "motion.ventilation_at": _VENTILATED,
        "motion.hold_duration": _HOLDING,
        "reference.preview": _CHANGING,
        "arm.presliding": _RUBBING,
    }
)
"""By key; of a vector for each of its entries."""


def check_controller(space: SweepSpace, params: Params) -> None:
    """Refuse a parameter of the controller that the architecture of every row leaves without effect.

    Raises:
        InputError: Such a parameter is swept.
    """
    swept = {axis.name for axis in space.axes}
    idle = IDLE.get(params.architecture, frozenset()) if "architecture" not in swept else frozenset()
    if name := next((name for name in sorted(swept) if name in idle), None):
        remedy = f"Leave it out, or take another architecture than {params.architecture}."
        raise _idle(name, "where the controller has the part that it is of", remedy)


def check_filters(space: SweepSpace, params: Params) -> None:
    """Refuse a filter of the experiment that every row replaces by its own.

    Raises:
        InputError: Such a filter is swept.
    """
    swept = {axis.name for axis in space.axes}
    for key, own in OWN_FILTERS.items():
        if key in swept and (own in swept or getattr(params, own) is not None):
            raise InputError(
                f"sweep.axes.{key}", "swept", f"swept where the controller has no {own}", f"Sweep {own} instead."
            )


def check_effect(spec: Any) -> None:
    """Refuse what no run depends on, neither one of the sweep nor one of its refinement.

    Args:
        spec: A `SweepSpec`.

    Raises:
        InputError: Such an axis is swept.
    """
    refine, swept = spec.refine, {axis.name for axis in spec.space.axes}
    changes = [] if refine is None else [stage.experiment for stage in refine.stages]
    changes += [] if refine is None or refine.rerun is None else [refine.rerun.experiment]
    met = [spec.experiment, *(spec.on(each).experiment for each in changes)]
    linear = "physics" not in swept and all(each.physics == "linear" for each in met)
    _check_ranked(spec, met)
    for name in sorted(swept):
        if linear and name.startswith(("arm.", "tissue.")):
            raise _idle(name, "where runs are on the arm: the linear loop has none", 'Set experiment.physics = "wam".')
        constant = name.removeprefix("tissue.").partition(".")[0] if name.startswith("tissue.") else None
        if linear and name == "guarded":
            raise _idle(
                name, "where runs are on the arm: the linear loop has no guard", 'Set experiment.physics = "wam".'
            )
        need = NEEDS.get(".".join(name.split(".")[:2]))
        if need is not None and not any(map(need.holds, met)):
            if not any(f"{other}.".startswith(f"{need.key}.") for other in swept - {name}):
                raise _idle(name, f"where {need.where}", need.remedy)
        laws = [law.name for law in LAWS.values() if constant in [each.name for each in law.parameters]]
        if laws and "tissue.kind" not in swept and not any(each.tissue.kind in laws for each in met):
            remedy = f'Set experiment.tissue.kind = "{laws[0]}".'
            raise _idle(name, f"where the tissue is of the law {' or '.join(laws)}", remedy)
        if name == "sensor.seed" and "sensor.noise" not in swept and not any(each.sensor.noise for each in met):
            raise _idle(name, "where the sensor has noise", "Set sensor.noise, or leave the seed out.")
        if name in DAMPING_FILTERS and linear and "damping" not in swept:
            if all(each.damping == "ideal" for each in met):
                raise _idle(name, "where the damping is sampled", 'Set experiment.damping = "sampled".')
        if name == "motion.seed" and not swept & MOTION_DRAWN:
            if not any(each.motion.drawn for each in met):
                remedy = 'Set motion.phases = "random", or a motion.rhythm that draws its beats, such as "variability".'
                raise _idle(name, "where something of the heart's motion is drawn", remedy)


def _check_ranked(spec: Any, met: Sequence[Experiment]) -> None:
    """Refuse to rank rows of the linear loop by what is measured on the arm alone: all would be as good as none.

    A limit on such a quantity may stand where a later stage runs on the arm, but for the swing's, which is NaN before.

    Args:
        spec: A `SweepSpec`.
        met: Its experiment, and those of its stages and rerun.

    Raises:
        InputError: They would be.
    """
    swept = next((axis.values for axis in spec.space.axes if axis.name == "physics"), None)
    runs = {*swept} if swept else {each.physics for each in met}
    some, every = "linear" in runs, runs == {"linear"}
    own = some if swept else spec.experiment.physics == "linear"
    front = spec.refine.goals if spec.refine is not None and spec.refine.method == "pareto" else ()
    limited = [name for name in spec.goal.constraints if every or (own and name == SWING)]
    ranked = {"sweep.best": [spec.goal.best] * some, "sweep.constraints": limited, "refine.goals": front * own}
    for key, names in ranked.items():
        if name := next((name for name in names if name in ON_ARM), None):
            remedy = 'Only on the arm it is measured: set experiment.physics = "wam", or take another metric.'
            raise InputError(key, name, "what runs on the linear loop measure, as some do that it ranks", remedy)


def _idle(name: str, where: str, remedy: str) -> InputError:
    """The error of an axis that has no effect."""
    return InputError(f"sweep.axes.{name}", "swept", f"swept {where}", remedy)
