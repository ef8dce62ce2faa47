"""How much each axis matters: shares of variance, and correlation of ranks."""

from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from jaxmpc.report.influence import crossed, first_order, stretches, varies
from sweeps.axis import SweepAxis
from sweeps.goal import MEASURED
from sweeps.result import Result


class Influence(NamedTuple):
    """What an axis does to a quantity."""

    share: float
    """Share of the variance of its logarithm that the axis explains alone, 0 … 1: a first-order Sobol index [-]."""
    correlation: float
    """Spearman's rank correlation, of rows that are OK everywhere; NaN of a choice and of what does not vary [-]."""


def sensitivity(result: Result, name: str) -> dict[str, Influence]:
    """The influence of every axis on a metric or margin at its worst over stiffness and axis.

    Shares are of all rows: those without a finite value count as twice as far as the worst of the others, in its
    logarithm, so that losing the loop counts, and those with an infinite margin as twice as far as the best. A value
    that is not positive has no logarithm: then it is taken as it is.

    Args:
        result: The sweep.
        name: The metric or margin.

    Raises:
        InputError: It was not kept.
    """
    values = result.worst(name)
    finite = np.isfinite(values)
    if not finite.any():
        return {axis.name: Influence(0.0, np.nan) for axis in result.axes}
    logarithmic = bool((values[finite] > 0.0).all())
    score = np.full(len(values), np.nan)
    score[finite] = np.log(values[finite]) if logarithmic else values[finite]
    low, high = float(score[finite].min()), float(score[finite].max())
    away = np.log(2.0) if logarithmic else (high - low) or 1.0
    # What is no number is as bad as can be; a margin may be infinitely good.
    above = np.isposinf(values) | (np.isnan(values) & MEASURED[name].ceiling)
    score = np.where(finite, score, np.where(above, high + away, low - away))
    exact = crossed([result[axis.name] for axis in result.axes])
    return {axis.name: _influence(axis, result, score, finite, exact) for axis in result.axes}


def _influence(axis: SweepAxis, result: Result, score: np.ndarray, finite: np.ndarray, exact: bool) -> Influence:
    alone = len(result.axes) == 1 and varies(score)
    share = 1.0 if alone else first_order(_cells(axis, result, exact), score, exact)
    entries = result[axis.name][finite]
    varied = axis.numeric and len(np.unique(entries)) > 1 and varies(score[finite])
    return Influence(share, float(spearmanr(entries, score[finite]).statistic) if varied else float("nan"))


def _cells(axis: SweepAxis, result: Result, exact: bool) -> np.ndarray:
    """Which value each row has, or which stretch of a range where rows, drawn or of a refinement, lie anywhere."""
    entries = result[axis.name]
    if exact or axis.scale == "choice" or (result.plan.space.kind == "grid" and not result.stages):
        which: np.ndarray = np.unique(entries, return_inverse=True)[1]
        return which
    return stretches(entries)
