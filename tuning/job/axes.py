"""The table [tune.free] of a job: which parameters move between which bounds, of the controller and of its knots."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError, nearest, within
from jaxmpc.quantities import FILTERS, PARAMETERS
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.structure import IDLE
from jaxmpc.synthesis.values import least_horizon
from tuning.job.space import KNOTS, Bounds, FreeParameter, axis_of


def free_table(table: Any, prefix: str = "") -> dict[str, Bounds | None]:
    """Bounds by name, None for the default ones.

    Args:
        table: Of the file; names of knots stand in tables of their own, `knots` and in it such as `2`.
        prefix: What names in it begin with.

    Raises:
        InputError: It is no table, or a value neither bounds nor true.
    """
    if not isinstance(table, dict):
        raise InputError("tune.free", table, "a table", "Write `[tune.free]` and one line per parameter.")
    free: dict[str, Bounds | None] = {}
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and (key == KNOTS[:-1] or prefix):
            free |= free_table(value, f"{name}.")
            continue
        numbers = isinstance(value, list) and all(type(x) in (int, float) for x in value)
        if not (value is True or (numbers and len(value) == 2)):
            remedy = "Leave a frozen parameter out; `true` takes the default bounds."
            raise InputError(f"tune.free.{name}", value, "[lowest, highest] or true", remedy)
        free[name] = None if value is True else (value[0], value[1])
    return free


def axes_of(
    free: Mapping[str, Bounds | None], diagonals: Collection[str], tied: Collection[str], params: Params
) -> list[FreeParameter]:
    """The axes of a job: one for each name, but for a name of all knots, which has one for each unless they are tied.

    Args:
        free: Bounds, None for the default ones, of "lam" of the controller, "knots.lam" of all knots but those that
            have their own, "knots.2.lam" of the second.
        diagonals: Parameters of the controller of which each entry is free by itself.
        tied: Parameters that all knots have in common.
        params: The controller.

    Raises:
        InputError: No such parameter or knot.
    """
    count, order = len(params.knots), params.disturbance_order
    found: list[FreeParameter] = []
    for name, bounds in free.items():
        which, _, parameter = name.removeprefix(KNOTS).rpartition(".") if name.startswith(KNOTS) else ("", "", name)
        key, given = f"tune.free.{name}", bounds or "true"
        if parameter not in PARAMETERS:
            raise InputError(key, given, "a known parameter", nearest(parameter, list(PARAMETERS)))
        if parameter in FILTERS and name.startswith(KNOTS):
            remedy = f"A signal is filtered before the tissue is known: write `{parameter} = {str(given).lower()}`."
            raise InputError(key, given, "a parameter of a knot", remedy)
        if not name.startswith(KNOTS):
            found.append(axis_of(name, bounds, name in diagonals, order))
            continue
        if not count:
            raise InputError(key, given, "free where there are knots", 'Start from some: published = "family".')
        if which and which not in map(str, range(1, count + 1)):
            raise InputError(key, which, f"a knot from 1 to {count}", "The first is that of the softest tissue.")
        others = tuple(i for i in range(count) if f"{KNOTS}{i + 1}.{parameter}" not in free)
        if which or parameter in tied:
            found.append(axis_of(name, bounds, False, order, (int(which) - 1,) if which else others))
        else:
            found += [axis_of(f"{KNOTS}{i + 1}.{parameter}", bounds, False, order, (i,)) for i in others]
    return found


def begun(params: Params, axes: Collection[FreeParameter], experiment: Experiment) -> Params:
    """The controller with filters of its own where they are free: the experiment's, or the quickest without one.

    Raises:
        InputError: The velocity's filter is free where the damping is ideal.
    """
    there = {"velocity_cutoff": experiment.velocity_lowpass, "force_cutoff": experiment.force_cutoff}
    own: dict[str, Any] = {}
    for axis in axes:
        if axis.name == "velocity_cutoff" and experiment.loop_path().ideal:
            remedy = 'Set experiment.damping = "sampled", or leave it out.'
            raise InputError(f"tune.free.{axis.name}", "free", "left out where the damping is ideal", remedy)
        if axis.name in there and getattr(params, axis.name) is None:
            own[axis.name] = there[axis.name] or axis.high
    return replace(params, **own)


def check_axis(axis: FreeParameter, params: Params) -> None:
    """Refuse a parameter that its architecture leaves without effect, and bounds that cannot be or leave out the start.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    key, row = f"tune.free.{axis.name}", PARAMETERS[axis.parameter]
    if axis.parameter in IDLE.get(params.architecture, ()):
        remedy = f"Leave it out, or take another architecture than {params.architecture}."
        raise InputError(key, "free", "left out where the controller does not have the part that it is of", remedy)
    (low, high), bounds = row.bounds, [axis.low, axis.high]
    if axis.parameter == "Hp":
        low = least_horizon(params.architecture)
    for value in bounds:
        for unit in [axis.counted_in(params, knot) for knot in axis.knots] or [1.0]:
            if not (math.isfinite(value) and low <= value * unit <= high):
                bound = within(low / unit, high / unit, axis.unit)
                raise InputError(key, value, bound, "Move this bound inside.")
    if axis.low >= axis.high:
        raise InputError(key, bounds, "[lowest, highest]", "Exchange or part the bounds.")
    if axis.whole and (axis.low % 1 or axis.high % 1):
        raise InputError(key, bounds, "whole numbers of samples", "Round them.")
    start = axis.of(params)
    if np.ndim(start) and not axis.length:
        remedy = f'Add "{axis.name}" to tune.diagonals, or start from one number.'
        raise InputError(f"params.{axis.name}", "a diagonal", "one number to be tuned as one", remedy)
    if np.any(start < axis.low) or np.any(start > axis.high):
        outside = np.atleast_1d(start)[np.atleast_1d((start < axis.low) | (start > axis.high))][0]
        remedy = f"The start {outside:g} lies outside: move it, or widen the bounds."
        raise InputError(key, bounds, "around the start point", remedy)


def check_horizons(axes: Sequence[FreeParameter]) -> None:
    """Refuse bounds of H_p that would press H_u, which is never longer, below its own.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    bounds = {axis.name: (axis.low, axis.high) for axis in axes}
    if "Hp" in bounds and "Hu" in bounds and bounds["Hp"][0] < (least := bounds["Hu"][0]):
        remedy = "Raise its lower bound, or lower that of Hu, which is never longer than Hp."
        raise InputError("tune.free.Hp", list(bounds["Hp"]), f"from {least:g} samples on, as tune.free.Hu", remedy)
