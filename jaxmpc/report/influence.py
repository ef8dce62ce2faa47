"""Importance by variance: which share of a goal's spread each parameter explains alone."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jaxmpc.report.content import Measure

MOST_BINS, ROWS_A_BIN = 32, 20
"""Stretches of a parameter's range, and rows that each should hold."""
UNSTABLE = 2.0
"""A row without a finite value counts as this times the worst of the others, in the sense of the goal."""


def influence(parameters: Sequence[Measure], goals: Sequence[Measure]) -> Mapping[str, np.ndarray]:
    """First-order indices of every goal, (parameters, 1 + tissues): the worst tissue first, then each.

    Goals that are positive throughout are taken in the logarithm.

    Args:
        parameters: Shape (rows,) each.
        goals: Shape (rows,) or (rows, tissues) each.
    """
    columns = [each.values for each in parameters]
    exact = crossed(columns)
    cells = [np.unique(each, return_inverse=True)[1] if exact else stretches(each) for each in columns]
    found = {}
    for goal in goals:
        each = [goal.worst] if goal.values.ndim == 1 else [goal.worst, *goal.values.T]
        scores = [_score(values, goal.sense == "floor") for values in each]
        found[goal.name] = np.array([[first_order(cell, score, exact) for score in scores] for cell in cells])
    return found


def crossed(columns: Sequence[np.ndarray]) -> bool:
    """Whether rows hold every combination of the parameters' values, and each as often: a whole grid.

    Args:
        columns: Of each parameter, (rows,); those that are swept together count as one.
    """
    places = [np.unique(values, return_inverse=True)[1] for values in columns]
    own = np.stack([place for i, place in enumerate(places) if not any((place == one).all() for one in places[:i])])
    sizes = [int(place.max()) + 1 for place in own]
    if math.prod(sizes) > own.shape[1]:
        return False
    counts = np.unique(own, axis=1, return_counts=True)[1]
    return len(counts) == math.prod(sizes) and bool((counts == counts[0]).all())


def stretches(values: np.ndarray) -> np.ndarray:
    """Each row's place among the values that a parameter takes, or among stretches that hold equally many rows."""
    points, cell = np.unique(values, return_inverse=True)
    bins = int(np.clip(len(values) // ROWS_A_BIN, 2, MOST_BINS))
    if len(points) <= bins:
        return cell
    edges = np.quantile(values, np.linspace(0.0, 1.0, bins + 1)[1:-1])
    return np.searchsorted(np.unique(edges), values, "right")


def first_order(cell: np.ndarray, score: np.ndarray, exact: bool = False) -> float:
    """Var(E[score | cell]) / Var(score), in [0, 1], less what chance alone would give.

    Args:
        cell: Each row's stretch of the parameter.
        score: Each row's value; all finite.
        exact: Whether rows are a whole grid, in which nothing is left to chance: whatever else is swept averages out.
    """
    rows, size = len(score), np.bincount(cell)
    spread = float(np.var(score))
    groups = int((size > 0).sum())
    if (rows <= groups and not exact) or groups < 2 or not varies(score):
        return 0.0
    means = np.bincount(cell, score) / np.maximum(size, 1)
    between = float((size * (means - score.mean()) ** 2).sum()) / rows
    if exact:
        return float(np.clip(between / spread, 0.0, 1.0))
    within = spread - between
    # Means of few rows scatter by chance: each group's by its variance over its size.
    unbiased = between - within * (groups - 1) / (rows - groups)
    return float(np.clip(unbiased / spread, 0.0, 1.0))


def varies(score: np.ndarray) -> bool:
    """Whether finite numbers differ by more than rounding, by which the deviation of equal ones need not be 0."""
    return bool(np.ptp(score) > 0.0 and np.var(score) > 1e-12 * float(np.mean(score)) ** 2)


def _score(values: np.ndarray, floor: bool) -> np.ndarray:
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros(len(values))
    worst = float(values[finite].min() if floor else values[finite].max())
    beyond = worst / UNSTABLE if floor == (worst > 0.0) else UNSTABLE * worst
    filled = np.where(finite, values, beyond)
    if floor:  # a margin may be infinitely good
        best = float(values[finite].max())
        filled = np.where(np.isposinf(values), UNSTABLE * best if best > 0.0 else best / UNSTABLE, filled)
    scored: np.ndarray = np.log(filled) if filled.min() > 0.0 else filled
    return scored
