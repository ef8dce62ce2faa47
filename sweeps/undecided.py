"""Rows whose status or rank is chance in float32: another program of the same loop may tell otherwise.

With a quantiser two programs part at the first count that is rounded the other way, and go through other samples of the
same noise. A row's value is then known to `Metric.float32_error`; times M_s / 3 where a loop is nearly unstable and
amplifies what it meets, and times √(4 s / T) where the scored time T, of the axis with the least, is shorter and
averages less. Design and margins are of float64, and certain. Where a torque limit acts nothing is known: the arm may
be thrown off in one program and not in the other.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxmpc.loop.linear import HIGHEST_ERROR, HIGHEST_FORCE
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from sweeps.goal import MEASURED, SweepGoal
from sweeps.judged import worst, worst_of_rows
from sweeps.met import met, scored_time
from sweeps.plan import Plan

TOP = 10
"""Best rows whose order is decided: as many as `jaxmpc sweep best` lists."""
AMPLIFYING = 3.0
"""Peak sensitivity from which on errors grow with it [-]."""
AVERAGING = 4.0
"""Scored time below which errors grow [s]."""
IN_FLOAT64 = "in_float64"
"""Column of a result: whether a row ran in float64."""
_UNTOLD = (Status.DIVERGED, Status.LOST_CONTACT)
"""No metric tells how near a row was to another end."""


class _Interval(NamedTuple):
    """Where a quantity lies, (rows,), as something to be minimised."""

    low: np.ndarray
    high: np.ndarray


def undecided(plan: Plan, columns: Mapping[str, np.ndarray], goal: SweepGoal | None = None) -> np.ndarray:
    """Places of the rows that float32 leaves undecided, the most important first.

    First rows that may be among the `TOP` best and overlap with another or may break a limit; then those whose status
    or limit is near; then those in which a torque limit acts, or of which no metric tells how near they were.

    Args:
        plan: What was swept.
        columns: What came out, every row; those that are `IN_FLOAT64` are certain.
        goal: How rows are ranked; None is the plan's.
    """
    goal = goal or plan.goal
    status, certain = columns["status"], columns[IN_FLOAT64]
    amplified = amplification(plan, columns)
    chance = ~certain[:, None] & (np.isin(status, _UNTOLD) | _saturated(columns))
    near = ~certain[:, None] & _near_limits(plan, columns) | chance
    untold = chance.any(axis=1)
    may, sure = ((status == Status.OK) | near).all(axis=1), (status == Status.OK).all(axis=1) & ~near.any(axis=1)
    borderline, hopeless = np.zeros((2, len(may)), bool)
    for name, limit in goal.constraints.items():
        found, ceiling = _interval(columns, name, amplified), limit if MEASURED[name].ceiling else -limit
        borderline |= ceiling < found.high
        may, sure = may & (found.low <= ceiling), sure & (found.high <= ceiling)
        if name in MARGINS:
            hopeless |= ~(found.low <= ceiling)
    value = _interval(columns, goal.best, amplified)
    # As a cost: a margin may be infinitely good, −∞.
    may, sure = may & (value.low < np.inf), sure & (value.high < np.inf)
    highest = np.sort(value.high[sure])
    reach = highest[TOP - 1] if len(highest) >= TOP else np.inf
    rivals = np.flatnonzero(may & ~untold & (value.low <= reach))
    open_rank = np.zeros(len(may), bool)
    open_rank[rivals] = _overlapping(_Interval(value.low[rivals], value.high[rivals])) | ~sure[rivals]
    open_rank &= ~certain
    places = np.flatnonzero(open_rank | near.any(axis=1) | borderline & may)
    kind = np.where(open_rank, 0, np.where(untold, 2, 1))
    order = np.where(hopeless | np.isnan(value.low), np.inf, value.low)
    return places[np.lexsort((places, order[places], kind[places]))]


def amplification(plan: Plan, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """What a metric's `float32_error` is to be multiplied with, (rows,) [-]."""
    sensitivity = worst(columns, "M_s")
    # Where the loop is unstable there is no metric.
    nearly = np.where(np.isfinite(sensitivity), np.maximum(1.0, sensitivity / AMPLIFYING), 1.0)
    amplified: np.ndarray = nearly * np.sqrt(np.maximum(1.0, AVERAGING / scored_time(plan, columns)))
    return amplified


def _interval(columns: Mapping[str, np.ndarray], name: str, amplified: np.ndarray) -> _Interval:
    """Where a quantity's worst value over stiffness and axis lies; NaN where there is none."""
    quantity = MEASURED[name]
    found = worst_of_rows(quantity, columns[name]).astype(float)
    cost = found if quantity.ceiling else -found
    error = np.zeros(len(cost))
    if name in METRICS:
        relative = METRICS[name].float32_error * amplified
        error = np.where(columns[IN_FLOAT64], 0.0, relative) * np.abs(cost)
    return _Interval(cost - error, cost + error)


def _overlapping(found: _Interval) -> np.ndarray:
    """Whether each interval has a part in common with another, more than an end."""
    order = np.argsort(found.low, kind="stable")
    low, high = found.low[order], found.high[order]
    above, below = np.append(low[1:], np.inf) < high, low < np.append(-np.inf, np.maximum.accumulate(high)[:-1])
    overlap = np.zeros(len(order), bool)
    overlap[order] = above | below
    return overlap


def _saturated(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Whether a torque limit acted, (rows, stiffness); False where that was not kept."""
    if "clamped" not in columns:
        return np.zeros(columns["status"].shape, bool)
    return _any(columns["clamped"] > 0.0)


def _near_limits(plan: Plan, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Whether force or residual came so near to a limit that another program may be beyond it, (rows, stiffness)."""
    limit = met(plan, columns, "force_limit")
    found = np.zeros(columns["status"].shape, bool)
    for name, limits in (("peak_force", (limit, HIGHEST_FORCE)), ("peak_error", (HIGHEST_ERROR,))):
        if name in columns:
            error = METRICS[name].float32_error
            for most in limits:
                at = np.broadcast_to(most, len(found))
                # Few are near at all, and a million rows take a while: none with √3 times its largest component below.
                lowest = np.min(at, initial=np.inf) / (2.0 * (1.0 + error))
                (rows,) = np.nonzero(_any(_any(columns[name] >= lowest)))
                x, y, z = np.moveaxis(columns[name][rows].astype(float), 2, 0)
                # The arm is judged by the length of the force, which lies between its largest component and this.
                largest, length = np.maximum(np.maximum(x, y), z), np.sqrt(x * x + y * y + z * z)
                here = at[rows, None]
                found[rows] |= (largest * (1.0 - error) < here) & (here <= length * (1.0 + error))
    return found


def _any(true: np.ndarray) -> np.ndarray:
    """`true.any(axis=-1)` where few are: numpy reduces many short rows ten times slower than it finds these."""
    found = np.zeros(true.shape[:-1], bool)
    found.reshape(-1)[np.flatnonzero(true) // true.shape[-1]] = True
    return found
