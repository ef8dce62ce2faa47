"""Rows judged: a metric or margin at its worst, whether a limit is kept, what the base controller comes to."""

from collections.abc import Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.quantities import METRICS, Quantity
from jaxmpc.status import Status
from sweeps.goal import MEASURED


class Point(NamedTuple):
    """One controller in the plane of the Pareto front."""

    rms: float
    """Largest residual RMS over stiffness and axis [N]; ∞ unless the status is OK at every stiffness."""
    M_s: float
    """Largest peak sensitivity over stiffness [-]."""


def baseline_of(summary: Mapping[str, Any]) -> Point | None:
    """The baseline in a folder's summary, where an infinity is null."""
    found = summary.get("baseline")
    if not (isinstance(found, list) and len(found) == 2 and all(isinstance(x, float | int | None) for x in found)):
        return None
    return Point(*(np.inf if value is None else value for value in found))


def worst(columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """A metric or margin at its worst over stiffness and axis, (rows,); ∞ or −∞, as is worse, where there is none.

    Metrics count only where the status is OK at every stiffness, margins wherever they are numbers.
    """
    quantity = MEASURED[name]
    failed = np.inf if quantity.ceiling else -np.inf
    found = worst_of_rows(quantity, columns[name])
    if name in METRICS:
        found = np.where((columns["status"] == Status.OK).all(axis=1), found, failed)
    worst_found: np.ndarray = np.where(np.isnan(found), failed, found)
    return worst_found


def worst_of_rows(quantity: Quantity, values: np.ndarray) -> np.ndarray:
    """The worst of each row of (rows, …); NaN where one is."""
    # numpy reduces many short rows ten times slower than a few long columns.
    columns = np.ascontiguousarray(values.reshape(len(values), prod(values.shape[1:])).T)
    found: np.ndarray = quantity.worst(columns, axis=0)
    return found


def keeps(columns: Mapping[str, np.ndarray], name: str, limit: float) -> np.ndarray:
    """Whether rows keep a limit, (rows,)."""
    kept: np.ndarray = MEASURED[name].kept(worst(columns, name), limit)
    return kept
