"""The result of a sweep, by name: what was swept, what came out, which rows are good.

    result = sweeps.load("runs/first")          # also of an unfinished sweep, or while it runs
    result.axes                                 # SweepAxis: name, unit, label(entry), numeric (else places of a choice)
    result["lam"], result["rms"], result["M_s"] # (rows,), (rows, stiffness, 3), (rows, stiffness)
    result.worst("rms")                         # (rows,): at its worst over stiffness and axis; ±∞ where not judged
    result.feasible                             # (rows,) bool: OK everywhere, and every constraint of the spec kept
    result.best(10), result.pareto("rms", "M_s", "chatter")         # Results of some rows, in order
    result.place(1234), result.controller(place), result.experiment(place), result.settings(place)
    result.tissues                              # (rows, stiffness): stiffness that each row met [N/m]
    result["in_float64"], result.undecided()    # rows that ran once more in float64; places of those that should
    result.stages                               # of a refined sweep: (name, Result) in order, the last is this one
    result.to_csv(path), result.to_xarray(), result.to_pandas()     # `sweeps.labelled`

Quantities (`jaxmpc.quantities`, here `MEASURED`) say unit, sense, digits and text of every metric and margin.
"""

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.synthesis.params import Params
from sweeps import chunks, labelled, store
from sweeps.decided import Decided, decided_together, read_decided, with_decided
from sweeps.goal import SweepGoal, check_goal
from sweeps.judged import Point, baseline_of
from sweeps.merging import merge
from sweeps.plan import Plan
from sweeps.ranked_rows import SweepRows
from sweeps.rows import experiment_of, meetings, stiffness_met, world_of
from sweeps.undecided import IN_FLOAT64, undecided

if TYPE_CHECKING:
    import pandas
    import xarray

SCREEN, FULL, AROUND, RERUN = "-screen", "-full", "-around", "-rerun"
"""How names of stages end."""


@dataclass(frozen=True)
class Result(SweepRows):
    """Rows of a sweep with all that is known of how they came about; `result["rms"]` is a column.

    Attributes:
        baseline: The base controller on the base experiment, once the sweep is finished.
        stages: Of a refined sweep: each stage's name and rows, in order.
        decided: What the rows that ran once more in float64 were in float32; None where none did.
        every_stage: Whether no stage of a refined sweep is missing or unfinished; True of any other.
    """

    baseline: Point | None = None
    stages: tuple[tuple[str, "Result"], ...] = field(default=(), compare=False, repr=False)
    decided: Decided | None = field(default=None, compare=False, repr=False)
    every_stage: bool = field(default=True, compare=False, repr=False)

    @staticmethod
    def load(folder: str | Path) -> "Result":
        """The rows that a sweep's folder holds so far; those of its last stage that has some, where it was refined.

        Raises:
            InputError: The folder is no sweep's.
        """
        folder = Path(folder)
        stages = [(path.name, Result.load(path)) for path in store.stage_folders(folder)]
        if stages:
            if len(stages) > 1 and not len(stages[-1][1]):
                # Only just begun: there is nothing to show.
                stages.pop()
            listed = store.read_summary(folder).get("stages")
            ended = isinstance(listed, dict) and listed.keys() == {name for name, _ in stages}
            return of_stages(stages, ended=ended)
        plan = store.read_plan(folder)
        columns, there = chunks.read_chunks(folder, plan)
        summary = store.read_summary(folder)
        result = Result.of(plan, columns, there, baseline_of(summary))
        found = read_decided(folder, plan, result.columns, finished=bool(summary)) if result.complete else None
        if found is None:
            return result
        rows, decided = with_decided(result.columns, *found)
        return replace(result, columns=rows, decided=decided)

    @staticmethod
    def of(plan: Plan, columns: Mapping[str, np.ndarray], there: np.ndarray, baseline: Point | None = None) -> "Result":
        """The rows that are there.

        Args:
            plan: What was swept.
            columns: Every planned row.
            there: Whether it is there, (rows,).
            baseline: See `Result`.
        """
        rows = dict(columns) if there.all() else {name: values[there] for name, values in columns.items()}
        exact = plan.canonical["precision"] == "float64"
        return Result(plan, {**rows, IN_FLOAT64: np.full(int(there.sum()), exact)}, baseline)

    def __repr__(self) -> str:
        swept = ", ".join(axis.name for axis in self.plan.space.axes)
        counts = ", ".join(f"{count} {name}" for name, count in self.status_counts().items() if count)
        tissues = f"{len(self.plan.stiffness)} stiffnesses [N/m]"
        return f"Result of a sweep of {swept}\n  {len(self)} rows × {tissues}: {counts}"

    @property
    def complete(self) -> bool:
        """Whether every planned row is here, every one that was to run once more in float64, and every stage."""
        decided = self.decided is None or self.decided.complete
        return self.every_stage and decided and len(self) == len(self.plan.rows)

    @cached_property
    def explored(self) -> "Result":
        """All rows of a refined sweep before the best were run once more; of any other this very result."""
        before = [stage for stage in self.stages if not stage[0].endswith(RERUN)]
        if len(before) == len(self.stages):
            return self
        return replace(_last(before), stages=self.stages, every_stage=self.every_stage)

    @cached_property
    def hash(self) -> str:
        """sha256 over the little-endian bytes of all columns in their fixed order; that of the result itself."""
        return self.plan.hash_of(self.columns)

    @cached_property
    def tissues(self) -> np.ndarray:
        """Stiffnesses that each row met, (rows, stiffness) [N/m]."""
        if not np.isnan(self.plan.stiffness).any():
            return np.broadcast_to(self.plan.stiffness, (len(self), len(self.plan.stiffness)))
        return stiffness_met(self.plan.canonical["experiment"], self.axes, self.columns)

    def undecided(self, goal: SweepGoal | None = None) -> np.ndarray:
        """Places of the rows whose status or rank is chance in float32, and that did not run in float64.

        Raises:
            InputError: The goal is of another type, or needs what was not kept.
        """
        if goal is not None:
            check_goal(goal)
            self._check_kept(*goal.names)
        return undecided(self.plan, self.columns, goal)

    def controller(self, place: int) -> Params:
        """The controller of one row, by its place in this result.

        Raises:
            InputError: There is no such row: of the best none where none keeps the constraints.
        """
        self._check_place(place)
        columns = {axis.name: self[axis.name][[place]] for axis in self.axes}
        (meeting,) = meetings(self.plan.base, self.axes, columns, by_world=True)
        return meeting.params[0]

    def experiment(self, place: int) -> Experiment:
        """The experiment that one row met; a recording is in a temporary folder, as long as this process lasts.

        Raises:
            InputError: There is no such row, or the content of the recording is not in the folder.
        """
        self._check_place(place)
        entries = tuple(float(self[axis.name][place]) for axis in self.axes if axis.of_world)
        data = world_of(self.plan.canonical["experiment"], self.axes, entries)
        folder = _recordings() if data["motion"]["file"] else Path()
        return experiment_of(self.plan.with_files(data, folder))

    def _check_place(self, place: int) -> None:
        whole = isinstance(place, int | np.integer) and not isinstance(place, bool)
        if not (whole and -len(self) <= place < len(self)):
            remedy = (
                "The best are those that keep the constraints: `jaxmpc sweep best DIR` tells what stands in the way."
            )
            raise InputError("place", place, f"of one of {len(self)} rows", remedy)

    def settings(self, place: int) -> dict[str, str]:
        """What the axes set for one row, for people.

        Raises:
            InputError: There is no such row.
        """
        self._check_place(place)
        return {axis.name: axis.label(float(self[axis.name][place])) for axis in self.axes}

    def to_csv(self, path: str | Path) -> None:
        """Write one line per row and stiffness; see `labelled.to_csv`."""
        labelled.to_csv(self, path)

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset with dimensions row, stiffness and axis; see `labelled.to_xarray`."""
        return labelled.to_xarray(self)

    def to_pandas(self) -> "pandas.DataFrame":
        """A table with a line per row and stiffness; see `labelled.to_pandas`."""
        return labelled.to_pandas(self)


@cache
def _recordings() -> Path:
    """Where recordings of rows are, once each, so that rows of one world have one experiment."""
    folder = tempfile.mkdtemp(prefix="jaxmpc-rows-")
    atexit.register(shutil.rmtree, folder, True)
    return Path(folder)


def merged(results: Sequence[Result]) -> Result:
    """Rows of several sweeps of the same axes as one, numbered as `merge` does; one alone stays as it is.

    Args:
        results: At least one.
    """
    first = results[0]
    if len(results) == 1:
        return first
    plan, columns = merge([(result.plan, result.columns) for result in results])
    decided = [result.decided for result in results if result.decided is not None]
    return Result(plan, columns, first.baseline, decided=decided_together(decided) if decided else None)


def of_stages(stages: Sequence[tuple[str, Result]], *, ended: bool) -> Result:
    """What stages of a refined sweep have led to.

    Args:
        stages: At least one, in order: its name and rows.
        ended: Whether no other comes.
    """
    whole = ended and all(stage.complete for _, stage in stages)
    return replace(_last(stages), stages=tuple(stages), every_stage=whole)


def _last(stages: Sequence[tuple[str, Result]]) -> Result:
    """The rows that stages have led to: of the last one, or of all rounds where rows were added around a front."""
    if not stages[-1][0].endswith(AROUND):
        return stages[-1][1]
    return merged([result for name, result in stages if name.endswith((FULL, AROUND))])
