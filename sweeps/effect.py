"""What a sweep may vary and rank by: something that its runs depend on, and that they measure."""

from typing import Any

from jaxmpc.files.errors import InputError
from jaxmpc.synthesis.params import Params
from jaxmpc.world.tissue import LAWS
from sweeps.goal import ON_ARM
from sweeps.space import SweepSpace
from sweeps.targets import OWN_FILTERS

DAMPING_FILTERS = ("velocity_lowpass", "velocity_cutoff")
"""What only damping by a sampled velocity passes through."""


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
    if linear:
        _check_ranked(spec)
    for name in sorted(swept):
        if linear and name.startswith(("arm.", "tissue.")):
            raise _idle(name, "where runs are on the arm: the linear loop has none", 'Set experiment.physics = "wam".')
        constant = name.removeprefix("tissue.").partition(".")[0] if name.startswith("tissue.") else None
        laws = [law.name for law in LAWS.values() if constant in [each.name for each in law.parameters]]
        if laws and "tissue.kind" not in swept and not any(each.tissue.kind in laws for each in met):
            remedy = f'Set experiment.tissue.kind = "{laws[0]}".'
            raise _idle(name, f"where the tissue is of the law {' or '.join(laws)}", remedy)
        if name == "sensor.seed" and "sensor.noise" not in swept and not any(each.sensor.noise for each in met):
            raise _idle(name, "where the sensor has noise", "Set sensor.noise, or leave the seed out.")
        if name in DAMPING_FILTERS and linear and "damping" not in swept:
            if all(each.damping == "ideal" for each in met):
                raise _idle(name, "where the damping is sampled", 'Set experiment.damping = "sampled".')
        if name == "motion.seed" and not swept & {"motion.kind", "motion.phases"}:
            if not any(each.motion.drawn for each in met):
                remedy = 'Set motion.kind = "rhythm" or motion.phases = "random".'
                raise _idle(name, "where something of the heart's motion is drawn", remedy)


def _check_ranked(spec: Any) -> None:
    """Refuse to rank rows of the linear loop by what is measured on the arm alone.

    Raises:
        InputError: They would be.
    """
    front = spec.refine.goals if spec.refine is not None and spec.refine.method == "pareto" else ()
    ranked = {"sweep.best": [spec.goal.best], "sweep.constraints": spec.goal.constraints, "refine.goals": front}
    for key, names in ranked.items():
        if name := next((name for name in names if name in ON_ARM), None):
            remedy = 'Only on the arm it is measured: set experiment.physics = "wam", or take another metric.'
            raise InputError(key, name, "what sweeps of the linear loop measure", remedy)


def _idle(name: str, where: str, remedy: str) -> InputError:
    """The error of an axis that has no effect."""
    return InputError(f"sweep.axes.{name}", "swept", f"swept {where}", remedy)
