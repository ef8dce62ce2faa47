"""Where to look next: rows that survive a stage, and new rows around a front. Both follow from the results alone."""

import math
from collections.abc import Sequence

import numpy as np

from jaxmpc.quantities import HORIZONS, MARGINS
from sweeps.axis import SweepAxis, whole
from sweeps.goal import SweepGoal
from sweeps.result import Result
from sweeps.space import Factor, SweepSpace

REACH = 0.1
"""Standard deviation of the first round around a front, over the range of an axis; each further one halves it [-]."""


def survivors(result: Result, keep: int) -> tuple[int, ...]:
    """Numbers of the rows that go on from a stage, ascending.

    First those that are good, the best first; then those whose margins keep their limits though the run does not, and
    those that are OK at least: a short or a simple run may judge a limit wrongly.

    Args:
        result: The stage.
        keep: How many at most.
    """
    goal = result.goal
    margins = {name: limit for name, limit in goal.constraints.items() if name in MARGINS}
    order = [
        *result.ranked(goal),
        *result.ranked(SweepGoal(goal.best, margins)),
        *result.ranked(SweepGoal(goal.best, {})),
    ]
    return tuple(sorted(result["row"][list(dict.fromkeys(order))[:keep]].tolist()))


def around(
    result: Result, factors: Sequence[Factor], goals: tuple[str, ...], points: int, seed: int, number: int
) -> SweepSpace:
    """New rows around the front of a result, none of which is there already.

    Each is a member of the front whose numbers are moved, in the scale of their axes and within their ranges; lists,
    choices and what is zipped with them stay as they are, and so do both horizons where H_u would exceed H_p.

    Args:
        result: All rows so far.
        factors: Axes of the sweep; those of one factor, which are zipped, move together.
        goals: What spans the front.
        points: How many rows at most.
        seed: Of what is drawn.
        number: Of the round, from 1.
    """
    found = result.pareto(*goals, feasible=False)
    close = found.feasible
    # A front has ends that nobody wants: the good part of it is looked at, if there is one.
    found = found.take(np.flatnonzero(close)) if close.any() else found
    base = found if len(found) else result.take(slice(1))
    random = np.random.Generator(np.random.Philox(key=np.array([seed, number], np.uint64)))
    parents = np.arange(points) % len(base)
    moves = random.standard_normal((points, len(factors))) * REACH / 2.0 ** (number - 1)
    columns = {
        axis.name: _moved(axis, base[axis.name][parents], moves[:, i]) if movable else base[axis.name][parents]
        for i, factor in enumerate(factors)
        for movable in [all(axis.ranged for axis in factor)]
        for axis in factor
    }
    # H_p and H_u may have been moved past each other.
    crossed = result.plan.space.crossed(columns)
    for factor in factors:
        if any(axis.name in HORIZONS for axis in factor):
            columns |= {axis.name: np.where(crossed, base[axis.name][parents], columns[axis.name]) for axis in factor}
    table = np.stack([columns[axis.name] for axis in result.axes], axis=1)
    there = {tuple(row) for row in np.stack([result[axis.name] for axis in result.axes], axis=1).tolist()}
    new = [row for row in dict.fromkeys(map(tuple, table.tolist())) if row not in there]
    return listed(result, np.array(new).reshape(-1, len(result.axes)))


def listed(result: Result, table: np.ndarray) -> SweepSpace:
    """A space of rows that are written out.

    Args:
        result: Whose axes these are.
        table: Entries, (rows, axes).
    """
    axes = []
    for axis, column in zip(result.axes, table.T, strict=True):
        entries = column.tolist()
        values = tuple(entries) if axis.numeric else tuple(axis.values[int(entry)] for entry in entries)
        labels = tuple(axis.labels[int(entry)] for entry in entries) if axis.labels else ()
        axes.append(SweepAxis(axis.name, axis.scale, values, axis.relative, labels))
    return SweepSpace("grid", (tuple(axes),), len(table), 0, result.plan.space.horizons)


def _moved(axis: SweepAxis, entries: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Entries moved by shares of their range."""
    low, high = min(axis.values), max(axis.values)
    if axis.scale == "log":
        moved = np.exp(np.log(entries) + moves * math.log(high / low))
    else:
        moved = entries + moves * (high - low)
    kept: np.ndarray = np.clip(np.round(moved) if whole(axis.name) else moved, low, high)
    return kept
