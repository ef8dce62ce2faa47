"""Goals on margins and on what a run measures, each a number that is at most 1 where the goal is met."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from jaxmpc.experiment import AXES
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS, METRICS, Metric, Quantity, check_limit
from jaxmpc.stability import Margins
from jaxmpc.xla.plain import library

RATIO = "ratio"
OVERSHOOT = "overshoot"
"""Overshoot of the linear loop after a step of the reference, worst tissue, relative to the step [-]."""

OF_JOINTS = ("clamped", "joint_torque", "torque_step")
"""Metrics that the joints of an arm have; of the linear loop they are 0, which would meet any goal."""


class RunGoal(NamedTuple):
    """What of a metric is bounded."""

    metric: Metric
    part: str
    """"" on every axis, the name of one axis, or `RATIO`: to the start point's value in the same scenario, tissue and
    axis."""


RUN_GOALS: Mapping[str, RunGoal] = {
    f"{name}_{part}" if part else name: RunGoal(metric, part)
    for name, metric in METRICS.items()
    for part in ("", *AXES, RATIO)
}
MEASURED: Mapping[str, Quantity] = {
    **{
        name: replace(goal.metric, name=name, unit="-", limits=(0.0, math.inf))
        if goal.part == RATIO
        else replace(goal.metric, name=name)
        for name, goal in RUN_GOALS.items()
    },
    OVERSHOOT: Quantity(OVERSHOOT, "-", "force beyond a step of its reference, of the linear loop", OVERSHOOT),
}
"""What may be a goal of the runs."""
GOALS: Mapping[str, Quantity] = {**MARGINS, **MEASURED}


class MarginGoals(NamedTuple):
    """How a loop stands to its margins."""

    normalised: Float[Array | np.ndarray, "goals ..."]
    """Value/limit of a ceiling such as M_s, else limit/value [-]: at most 1 where met, ∞ where unstable."""
    inverse: Float[Array | np.ndarray, "goals ..."]
    """Its inverse [-]: at least 1 where met, 0 where unstable."""
    violation: Float[Array | np.ndarray, "..."]
    """What is to be brought to zero [-], summed over goals and stiffness; see `margin_goals`."""


@np.errstate(divide="ignore", invalid="ignore")
def margin_goals(margins: Margins, limits: Mapping[str, Any], headroom: float = 0.0) -> MarginGoals:
    r"""Margins of one controller over its stiffnesses, stability first; traceable, differentiable.

        violation = Σ max(0, 1 − 1/g + headroom)   where every stiffness is stable, g the normalised goal
                  = Σ max(0, log ρ) + 1 per goal and stiffness   where one is not

    1 − 1/g grows from 0 at the limit to 1 at the edge of stability and has a finite slope all the way. Beyond
    that edge margins mean nothing (M_s is ∞ and has no slope), so the spectral radius ρ alone leads back.

    Args:
        margins: Over the stiffnesses, each field (stiffness,).
        limits: Limit per goal, a key of `MARGINS`.
        headroom: How far inside its limit a goal is aimed at [-].
    """
    xp = library(margins, limits)
    none = xp.zeros((0, *margins.M_s.shape))
    values = {name: getattr(margins, name) for name in limits}
    rows = [limit / values[name] if MARGINS[name].ceiling else values[name] / limit for name, limit in limits.items()]
    inverse = xp.stack(rows) if rows else none
    stable = margins.spectral_radius < 1.0
    inverse = xp.where(stable, inverse, 0.0)
    missed = xp.sum(xp.maximum(1.0 - inverse + headroom, 0.0))
    outside = xp.sum(xp.maximum(xp.log(margins.spectral_radius), 0.0)) + inverse.size
    return MarginGoals(1.0 / inverse, inverse, xp.where(xp.all(stable), missed, outside))


@np.errstate(divide="ignore", invalid="ignore")
def run_goals(
    metrics: Metrics, reference: Metrics, overshoot: Any, limits: Mapping[str, Any]
) -> dict[str, Float[Array | np.ndarray, "... stiffness scenarios axes"]]:
    """Goals on what the runs measured, normalised; traceable, differentiable.

    Args:
        metrics: Each field (…, stiffness, scenarios, 3).
        reference: Of the start point, the same. A cell that is not a number there, where the start point was
            unstable, counts as met by whatever is one; of one that is zero, only zero is no more.
        overshoot: Relative to the step, (…, stiffness); needed for that goal alone [-].
        limits: Limit per goal, a key of `MEASURED`.

    Returns:
        Value over limit per goal [-], each (…, stiffness, scenarios, 1 or 3).
    """
    xp = library(metrics, reference, overshoot, limits)
    found = {}
    for name, limit in limits.items():
        if name == OVERSHOOT:
            found[name] = overshoot[..., None, None] / limit
            continue
        metric, part = RUN_GOALS[name]
        cells = getattr(metrics, metric.name)
        if part == RATIO:
            before = getattr(reference, metric.name)
            known = xp.isfinite(before) & (before > 0.0)
            more = xp.where((before == 0.0) & (cells > 0.0), np.inf, 0.0 * cells)  # NaN stays NaN
            cells = xp.where(known, cells / xp.where(known, before, 1.0), more)
        elif part:
            place = AXES.index(part)
            cells = cells[..., place : place + 1]
        found[name] = cells / limit
    return found


def check_goals(goals: Mapping[str, Any], table: str, known: Mapping[str, Quantity]) -> None:
    """Refuse goals that are unknown, or have a limit that nothing can keep or nothing can miss.

    Args:
        goals: Limits by name, each in its quantity's unit.
        table: Of the job's file.
        known: Quantities that may be goals there.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    for name, limit in goals.items():
        if name in MARGINS and name not in known:
            raise InputError(f"{table}.{name}", limit, "a goal of the runs", "Margins are held: put it under [goals].")
        if name not in known:
            remedy = nearest(name, [*known, "ideal", "soft"] if table == "goals" else list(known))
            raise InputError(f"{table}.{name}", limit, "a known goal", remedy)
        check_limit(f"{table}.{name}", known[name], limit, "Give a limit, or leave it out.")


def refuse_goals_of_joints(goals: Mapping[str, Any], table: str) -> None:
    """Refuse, for a job on the linear loop, what only an arm has.

    Args:
        goals: By name.
        table: Of the job's file.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    for name, limit in goals.items():
        if name in RUN_GOALS and RUN_GOALS[name].metric.name in OF_JOINTS:
            remedy = 'The linear loop has no joints: set experiment.physics = "wam", or leave it out.'
            raise InputError(f"{table}.{name}", limit, "a goal on the arm only", remedy)
