"""Rows that float32 cannot decide, once more in float64: a sweep of these rows alone in a folder inside the sweep's.

    runs/first/float64/0123456789ab/     named by the hash of its spec: another ranking leaves other rows undecided

Which rows these are follows from those in float32 and the goal alone, so the folder resumes and is shared as any other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmpc.quantities import METRICS
from sweeps import chunks
from sweeps.goal import SweepGoal
from sweeps.judged import worst
from sweeps.merging import merge
from sweeps.plan import Columns, Plan
from sweeps.undecided import IN_FLOAT64, undecided

MANY = 50_000
"""Rows of a sweep, some of which are near enough to each other or to a limit, whatever it is of."""


@dataclass(frozen=True)
class Decided:
    """What float64 says of the rows that float32 could not decide.

    Attributes:
        plan: These rows in float64.
        before: Their columns in float32.
        after: The same in float64.
    """

    plan: Plan
    before: Columns
    after: Columns

    @property
    def complete(self) -> bool:
        """Whether every one of them is here."""
        return len(self.after["row"]) == len(self.plan.rows)

    @property
    def there(self) -> str:
        """How many of them are here, in words."""
        return f"{len(self.after['row'])} of {len(self.plan.rows)} in float64"

    def sentence(self, goal: SweepGoal) -> str:
        """How many they are and what chance had done to them, for a person."""
        was, now = worst(self.before, goal.best), worst(self.after, goal.best)
        both = np.isfinite(was) & np.isfinite(now) & (now != 0.0)
        change = np.max(np.abs(was[both] / now[both] - 1.0), initial=0.0)
        other = int((self.before["status"] != self.after["status"]).any(axis=1).sum())
        rows = f"{len(now)} rows that float32 cannot decide were run once more in float64"
        return f"{rows}: {other} ended otherwise, {goal.best} changed by up to {100.0 * change:.2g} %"


def decided_together(parts: Sequence[Decided]) -> Decided:
    """What float64 says of several sweeps of the same axes, as of one; see `merging.merge`.

    Args:
        parts: At least one.
    """
    plan, after = merge([(part.plan, part.after) for part in parts])
    return Decided(plan, merge([(part.plan, part.before) for part in parts])[1], after)


def plan_in_float64(plan: Plan, columns: Mapping[str, np.ndarray]) -> Plan | None:
    """The rows that are run once more; None where there is nothing to decide.

    Args:
        plan: A sweep.
        columns: All its rows.
    """
    if plan.canonical["precision"] == "float64" or not plan.goal.decide:
        return None
    places = undecided(plan, columns)[: plan.goal.decide]
    return _alone(plan, np.sort(columns["row"][places])) if len(places) else None


def likely_in_float64(plan: Plan) -> Plan | None:
    """One row in float64, by the program of all that will be; None unless there are so `MANY` rows that some will."""
    decides = plan.canonical["precision"] == "float32" and plan.goal.decide and len(plan.rows) >= MANY
    return _alone(plan, plan.rows[:1]) if decides else None


def _alone(plan: Plan, rows: np.ndarray) -> Plan:
    space = {**plan.canonical["space"], "only": rows.tolist()}
    return Plan({**plan.canonical, "precision": "float64", "space": space}, plan.files, plan.goal, plan.engine)


def folder_of(folder: Path, plan: Plan) -> Path:
    """Where the rows lie that are run once more.

    Args:
        folder: The sweep's.
        plan: In float64.
    """
    return folder / "float64" / plan.spec_hash[:12]


def read_decided(
    folder: Path, plan: Plan, columns: Mapping[str, np.ndarray], *, finished: bool
) -> tuple[Plan, Columns] | None:
    """The rows that were run once more so far, and their plan; None where none is to be.

    Args:
        folder: The sweep's.
        plan: A sweep.
        columns: All its rows.
        finished: Whether it came to an end, with these rows or, as sweeps from before did, without any.
    """
    if finished and not (folder / "float64").is_dir():
        return None
    again = plan_in_float64(plan, columns)
    if again is None or (finished and not folder_of(folder, again).is_dir()):
        return None
    return again, read_again(folder, again)


def read_again(folder: Path, again: Plan) -> Columns:
    """Those of the rows that are run once more that are there.

    Args:
        folder: The sweep's.
        again: These rows in float64.
    """
    found, there = chunks.read_chunks(folder_of(folder, again), again)
    return {name: values[there] for name, values in found.items()} | {IN_FLOAT64: np.full(int(there.sum()), True)}


def with_decided(
    columns: Mapping[str, np.ndarray], again: Plan, found: Mapping[str, np.ndarray]
) -> tuple[Columns, Decided]:
    """All rows, those with float64's numbers that were run once more; what ranks and limits keeps all its digits.

    Args:
        columns: All rows, by ascending numbers.
        again: The rows that are run once more.
        found: Their columns, as far as they are there.
    """
    places = np.searchsorted(columns["row"], found["row"])
    exact = {name for name in again.goal.names if name in METRICS}
    merged: Columns = {}
    for name, values in columns.items():
        merged[name] = values.astype(np.float64 if name in exact else values.dtype)
        merged[name][places] = found[name]
    before = {name: values[places] for name, values in columns.items()}
    return merged, Decided(again, before, dict(found))
