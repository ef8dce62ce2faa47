"""What is swept, from a TOML file: experiment, base controller, axes, and what makes a row a good one."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

from msgspec.structs import replace as changed

from jaxmpc import described
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.job import experiment_table, params_table
from jaxmpc.files.errors import InputError, check_table, counted, nearest
from jaxmpc.files.toml import convert, known_keys, known_tables, located, read_toml
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from sweeps.effect import check_controller, check_effect, check_filters
from sweeps.goal import MEASURED, SweepGoal, columns_kept
from sweeps.reading import check_worlds, flattened, read_space, stiffness_set
from sweeps.space import SweepSpace
from sweeps.tables import OnError, Precision, RefineTable, SweepTable


@dataclass(frozen=True)
class SweepSpec:
    """A sweep: every row of `space`, otherwise like `params` on `experiment`.

    Attributes:
        experiment: What the controllers meet.
        params: The base controller, which is also the baseline of the report.
        space: The swept parameters of both.
        precision: Of the time stepping; None is as `sweeps.precision` finds.
        name: For people; no part of the spec's hash.
        goal: How rows are ranked; no part of the spec's hash.
        kept: Metrics and margins that are kept.
        on_error: What to do about a chunk that cannot be computed; no part of the spec's hash.
        engine: Which one runs the rows; None is the fastest here. No part of the spec's hash.
        refine: How it goes on from there (`sweeps.refine`); None is not at all.
    """

    experiment: Experiment
    params: Params
    space: SweepSpace
    precision: Precision | None = None
    name: str = "sweep"
    goal: SweepGoal = field(default_factory=SweepGoal)
    kept: tuple[str, ...] = tuple(MEASURED)
    on_error: OnError = "keep"
    refine: RefineTable | None = None
    engine: str | None = None

    def __post_init__(self) -> None:
        given = {} if self.precision is None else {"precision": (self.precision, Precision)}
        for key, (value, known) in {**given, "on_error": (self.on_error, OnError)}.items():
            if value not in get_args(known):
                raise InputError(f"sweep.{key}", value, "a known word", nearest(value, list(get_args(known))))
        for name in self.kept:
            if name not in MEASURED:
                raise InputError("sweep.columns", name, "a metric or margin", nearest(name, list(MEASURED)))
        if lost := next((name for name in self.goal.names if name not in self.kept), None):
            raise InputError("sweep.columns", ", ".join(self.kept), f"with {lost}", "It ranks or limits the rows.")

    def __repr__(self) -> str:
        lines = [
            described.Line(axis.name, described.values(axis.values), described.unit(axis), axis.scale)
            if axis.numeric
            else described.Line(axis.name, ", ".join(map(axis.label, range(len(axis.values)))), "", axis.scale)
            for axis in self.space.axes
        ]
        lines += [described.Line("ranked by", self.goal.text, "", ""), *described.experiment(self.experiment)[1]]
        title = f"SweepSpec {self.name}, {self.space.kind}, {self.space.count} rows on {self.experiment.name}"
        return described.as_text(title, lines)

    @staticmethod
    def from_toml(path: str | Path) -> "SweepSpec":
        """A sweep from its file; other files that it names are looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        data = read_toml(path)
        with located(path):
            return SweepSpec.from_dict(data, Path(path).parent, Path(path).stem)

    @staticmethod
    def from_dict(data: dict[str, Any], folder: Path = Path(), name: str = "sweep") -> "SweepSpec":
        """A sweep from plain data.

        Args:
            data: Keys as in the TOML file.
            folder: Where the files lie that it names.
            name: For people.

        Raises:
            InputError: A key is unknown, a value of the wrong type or out of bounds, or a part of the controller does
                nothing at a row's sampling time.
        """
        check_table("spec", data)
        known_tables(data, ("experiment", "params", "sweep", "refine"))
        if "sweep" not in data:
            raise InputError("sweep", "missing", "a table", 'Add [sweep] with kind = "grid" and [sweep.axes].')
        known_keys(SweepTable, data["sweep"], "sweep")
        table = convert(data["sweep"], SweepTable, "sweep")
        world = dict(data.get("experiment", {}))
        if isinstance(wanted := world.get("stiffness"), str):
            world["stiffness"] = stiffness_set(wanted, table.stiffness_sets, "experiment.stiffness")
        experiment = experiment_table(world, folder)
        params = params_table(data.get("params", {}), folder)
        limits = {} if table.constraints is None else {"constraints": table.constraints}
        goal = SweepGoal(table.best, decide=table.decide, **limits)
        space = read_space(table, params, experiment, folder)
        check_filters(space, params)
        check_controller(space, params)
        kept = columns_kept(table.columns, goal)
        spec = SweepSpec(experiment, params, space, table.precision, name, goal, kept, table.on_error)
        spec = replace(spec, refine=_refine(data["refine"], spec, folder)) if "refine" in data else spec
        check_effect(spec)
        _check_sampled(spec)
        return spec

    def on(self, changes: dict[str, Any], root: str = "experiment") -> "SweepSpec":
        """The same sweep on a changed experiment.

        Args:
            changes: Keys of the experiment; those of a table change that key alone.
            root: Name of the table that they stand in, for messages.

        Raises:
            InputError: They do not make an experiment.
        """
        data = self.experiment.to_dict()
        for key, value in changes.items():
            merge = isinstance(value, dict) and isinstance(data.get(key), dict)
            data[key] = {**data[key], **value} if merge else value
        try:
            return replace(self, experiment=Experiment.from_dict(data, root=root))
        except InputError as error:
            # What does not go together is told by keys that the base's own table has, too.
            error.key = f"{root}.{error.key.removeprefix(f'{root}.')}"
            raise

    def only(self, rows: Sequence[int]) -> "SweepSpec":
        """The same sweep of some rows alone, which keep their numbers and their bits.

        Raises:
            InputError: There are none, or one is no number of a row.
        """
        if not len(rows):
            raise InputError("rows", "none", "the number of one row at least", "Ask for rows that are there.")
        remedy = "Rows are counted from 0, those of a grid with Hu > Hp too."
        numbers = {counted("rows", row, remedy, 0, self.space.count - 1) for row in rows}
        return replace(self, space=changed(self.space, only=tuple(sorted(numbers))))


def _check_sampled(spec: SweepSpec) -> None:
    """Refuse a part of a row's controller that does nothing as slowly as some row is sampled.

    Raises:
        InputError: There is one.
    """
    guards = (axis.values for axis in spec.space.axes if axis.name == "guarded")
    check_sampling(replace(spec.params, guarded=any(next(guards, (spec.params.guarded,)))), _slowest(spec))


def _slowest(spec: SweepSpec) -> float:
    """The longest sampling time of a row [s]."""
    base = spec.experiment.sampling_time
    axes = [axis for axis in spec.space.axes if axis.name == "sampling_time"]
    return max((axis.setting(value, base) for axis in axes for value in axis.values), default=base)


def _refine(data: Any, spec: SweepSpec, folder: Path) -> RefineTable:
    """The table [refine], checked against the sweep that it refines; recordings are looked for in the folder.

    Raises:
        InputError: It does not go with the sweep.
    """
    known_keys(RefineTable, data, "refine")
    table = convert(data, RefineTable, "refine")
    stages = tuple(changed(stage, experiment=_beside(stage.experiment, folder)) for stage in table.stages)
    rerun = table.rerun and changed(table.rerun, experiment=_beside(table.rerun.experiment, folder))
    table = changed(table, stages=stages, rerun=rerun)
    for key in ("stages", "rounds", "points", "goals", "seed"):
        wanted = "halving" if key == "stages" else "pareto"
        if key in data and table.method != wanted:
            raise InputError(f"refine.{key}", "given", f'given with method = "{wanted}"', f"Remove {key}.")
    if table.method == "halving" and not table.stages:
        remedy = "Add [[refine.stages]] with keep = 400 and experiment = { duration = 4.0 }, say."
        raise InputError("refine.stages", "empty", "one stage or more", remedy)
    if table.method == "none" and table.rerun is None:
        raise InputError("refine.method", "none", '"halving", "pareto", or with a rerun', "Remove [refine].")
    if table.method == "pareto":
        if spec.space.of_worlds:
            bound = "of parameters of the controller alone"
            raise InputError("refine.method", "pareto", bound, "Rows of different worlds have no common front.")
        if not any(all(axis.ranged for axis in factor) for factor in spec.space.factors):
            remedy = "Lists have nothing between their values, nor has what is zipped with them: give a range."
            raise InputError("refine.method", "pareto", "with a range among the axes", remedy)
        if not table.goals:
            raise InputError("refine.goals", "[]", "at least one goal", 'Leave it out for ["rms", "M_s"].')
        for goal in table.goals:
            if goal not in spec.kept:
                raise InputError("refine.goals", goal, "kept by the sweep", nearest(goal, list(spec.kept)))
    keeps = [stage.keep for stage in table.stages]
    if keeps != sorted(keeps, reverse=True):
        raise InputError("refine.stages", keeps, "ever fewer rows", "A later stage keeps a part of an earlier one.")
    changes = {f"refine.stages[{i}].experiment": stage.experiment for i, stage in enumerate(table.stages)}
    if table.rerun is not None:
        changes["refine.rerun.experiment"] = table.rerun.experiment
    swept = [axis.name for axis in spec.space.axes]
    for root, each in changes.items():
        there = spec.on(each, root)
        for key, _ in flattened(each):
            if axis := next((name for name in swept if _within(name, key) or _within(key, name)), None):
                remedy = f"Rows keep what {axis} gave them: leave it out of one of both."
                raise InputError(f"{root}.{key}", "changed", "of what is not swept", remedy)
        _check_rows(there, root)
    return table


def _beside(changes: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same keys of an experiment; a recording lies in the folder."""
    motion = changes.get("motion")
    if not (isinstance(motion, dict) and isinstance(motion.get("file"), str) and motion["file"]):
        return changes
    return {**changes, "motion": {**motion, "file": str(folder / motion["file"])}}


def _check_rows(stage: SweepSpec, root: str) -> None:
    """Refuse a stage on which a row that gets there would have no world, or no controller that works as it is sampled.

    Raises:
        InputError: Of the axis or key that does not go with what `root` changes.
    """
    try:
        check_worlds(stage.space.factors, stage.experiment)
        _ = stage.experiment.scored
        _check_sampled(stage)
    except InputError as error:
        raise InputError(error.key, error.value, f"{error.bound}, with {root}", error.remedy) from None


def _within(name: str, other: str) -> bool:
    """Whether a dotted name is another, or an entry of it."""
    return f"{name}.".startswith(f"{other}.")
