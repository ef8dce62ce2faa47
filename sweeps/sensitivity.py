"""How much each axis matters: shares of variance, and correlation of ranks."""

from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from sweeps.axis import SweepAxis
from sweeps.result import Result

BINS = 12
"""Stretches into which a drawn range is cut."""


class Influence(NamedTuple):
    """What an axis does to a quantity."""

    share: float
    """Share of the variance of its logarithm that the axis explains alone, 0 … 1: a first-order Sobol index [-]."""
    correlation: float
    """Spearman's rank correlation, of rows that are OK everywhere; NaN of a choice and of what does not vary [-]."""


def sensitivity(result: Result, name: str) -> dict[str, Influence]:
    """The influence of every axis on a metric or margin at its worst over stiffness and axis.

    Shares are of all rows: those without a finite value count as twice as far as the worst of the others, in its
    logarithm, so that losing the loop counts. A value that is not positive has no logarithm: then it is taken as it is.

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
    lost = high + (np.log(2.0) if logarithmic else high - low)
    score = np.where(finite, score, lost if np.isposinf(values[~finite]).any() else low - (lost - high))
    return {axis.name: _influence(axis, result, score, finite) for axis in result.axes}


def _influence(axis: SweepAxis, result: Result, score: np.ndarray, finite: np.ndarray) -> Influence:
    cells = _cells(axis, result[axis.name], result.plan.space.kind != "grid")
    size = np.bincount(cells)
    means = np.bincount(cells, score) / np.maximum(size, 1)
    variance = float(score.var())
    between = float((size * (means - score.mean()) ** 2).sum() / len(score))
    # Means of few rows differ by chance: what chance alone would give is taken off.
    within = max(variance - between, 0.0)
    used = int((size > 0).sum())
    by_chance = within * (used - 1) / max(len(score) - used, 1) if len(score) > used else 0.0
    share = min(max((between - by_chance) / variance, 0.0), 1.0) if variance > 0.0 else 0.0
    entries = result[axis.name][finite]
    varied = axis.numeric and len(np.unique(entries)) > 1 and float(score[finite].std()) > 0.0
    return Influence(share, float(spearmanr(entries, score[finite]).statistic) if varied else float("nan"))


def _cells(axis: SweepAxis, entries: np.ndarray, sampled: bool) -> np.ndarray:
    """Which value, or which stretch of the range, each row has."""
    if not sampled or axis.scale in ("list", "choice"):
        which: np.ndarray = np.unique(entries, return_inverse=True)[1]
        return which
    edges = np.quantile(entries, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    cells: np.ndarray = np.searchsorted(edges, entries, "right")
    return cells
