"""Rows of a sweep by name, and which of them are good."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from jaxmpc.files.errors import InputError, counted, nearest, truth
from jaxmpc.status import Status
from sweeps.axis import SweepAxis
from sweeps.front import front
from sweeps.goal import MEASURED, SweepGoal, check_goal
from sweeps.judged import worst
from sweeps.plan import Plan


@dataclass(frozen=True)
class SweepRows:
    """Rows of a sweep; `rows["rms"]` is a column, shape (rows, stiffness, 3).

    Attributes:
        plan: What was swept.
        columns: Row number, entries of the axes, status, metrics and margins (`jaxmpc.quantities`); and whether the row
            ran in float64, as those of a float32 sweep do that it cannot decide.
    """

    plan: Plan
    columns: Mapping[str, np.ndarray]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.columns["row"])

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise InputError("column", name, "a column of the result", nearest(name, list(self.columns)))
        return self.columns[name]

    @property
    def goal(self) -> SweepGoal:
        """How rows are ranked."""
        return self.plan.goal

    @property
    def axes(self) -> tuple[SweepAxis, ...]:
        """What was swept."""
        return self.plan.space.axes

    @cached_property
    def ok(self) -> np.ndarray:
        """Whether each row's status is OK at every stiffness, (rows,)."""
        good: np.ndarray = (self["status"] == Status.OK).all(axis=1)
        return good

    @cached_property
    def feasible(self) -> np.ndarray:
        """Whether each row is OK at every stiffness and keeps every constraint of the spec, (rows,)."""
        return self._within(self.goal)

    def worst(self, name: str) -> np.ndarray:
        """A metric or margin at its worst over stiffness and axis, (rows,); ±∞ where there is none.

        Raises:
            InputError: It was not kept.
        """
        self._check_kept(name)
        return worst(self.columns, name)

    def take(self, places: "np.ndarray | slice") -> Self:
        """Some rows, in the order given, by their places in this result."""
        return replace(self, columns={name: values[places] for name, values in self.columns.items()})

    def place(self, row: int) -> int:
        """Where a row stands in this result, by its number.

        Raises:
            InputError: It is not here, or no number of a row.
        """
        whole = isinstance(row, int | np.integer) and not isinstance(row, bool)
        found = np.flatnonzero(self["row"] == row) if whole else np.zeros(0, int)
        if not len(found):
            bound = f"one of the {len(self)} rows, {self['row'].min()} … {self['row'].max()}" if len(self) else "there"
            remedy = "Rows with Hu > Hp, that a stage left behind, or not yet computed are not here."
            raise InputError("row", row, bound, remedy)
        return int(found[0])

    def ranked(self, goal: SweepGoal | None = None) -> np.ndarray:
        """Places of the good rows, the best first.

        Raises:
            InputError: The goal is of another type, or needs what was not kept.
        """
        goal = self.goal if goal is None else goal
        places, cost = np.flatnonzero(self.good(goal)), self._cost(goal)
        return places[np.argsort(cost[places], kind="stable")]

    def good(self, goal: SweepGoal) -> np.ndarray:
        """Whether each row is OK at every stiffness, keeps every constraint and has what ranks, (rows,).

        Raises:
            InputError: The goal is of another type, or needs what was not kept.
        """
        check_goal(goal)
        # A margin may be infinitely good.
        good: np.ndarray = (self._cost(goal) < np.inf) & self._within(goal)
        return good

    def best(self, n: int = 10, max_M_s: float | None = None) -> Self:
        """The best of the rows that keep the constraints.

        Args:
            n: How many at most, 1 or more.
            max_M_s: Largest accepted worst-case peak sensitivity [-]; None is the spec's.

        Raises:
            InputError: `n` is no such number, or the limit not finite.
        """
        n = counted("n", n, "Ask for one row or more.")
        goal = self.goal if max_M_s is None else self.goal.limited({"M_s": max_M_s})
        return self.take(self.ranked(goal)[:n])

    def pareto(self, *goals: str, feasible: bool = False) -> Self:
        """The rows, OK at every stiffness, that no other such beats in every goal at once, ordered by the last goal.

        Args:
            goals: Metrics and margins, each at its worst; by default the residual and M_s.
            feasible: Whether rows that break a constraint stay out of it.

        Raises:
            InputError: A goal was not kept by the sweep, or `feasible` is no truth value.
        """
        feasible = truth("feasible", feasible, "True leaves rows out that break a constraint.")
        names = goals or ("rms", "M_s")
        table = np.stack([self.worst(name) * (1.0 if MEASURED[name].ceiling else -1.0) for name in names], axis=1)
        places = np.flatnonzero((table < np.inf).all(axis=1) & (self.feasible if feasible else self.ok))
        places = places[front(table[places])]
        return self.take(places[np.lexsort(table[places].T)])

    def status_counts(self) -> dict[str, int]:
        """How many (row, stiffness) pairs ended in each `Status`."""
        return {status.name: int((self["status"] == status).sum()) for status in Status}

    def _check_kept(self, *names: str) -> None:
        for name in names:
            if name not in self.plan.kept:
                raise InputError("quantity", name, "kept by the sweep", nearest(name, list(self.plan.kept)))

    def _cost(self, goal: SweepGoal) -> np.ndarray:
        values = self.worst(goal.best)
        return values if MEASURED[goal.best].ceiling else -values

    def _within(self, goal: SweepGoal) -> np.ndarray:
        good = self.ok
        for name, limit in goal.constraints.items():
            good = good & MEASURED[name].kept(self.worst(name), limit)
        return good
