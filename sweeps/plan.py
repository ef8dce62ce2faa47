"""A spec with everything resolved: its canonical form, its hash, and what each row holds."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError, counted
from jaxmpc.files.foreign import LARGEST_RECORDING, read_bytes
from jaxmpc.files.sealed import LARGEST, canonical_json, digest, write_atomic
from jaxmpc.quantities import AXES, METRICS, PARAMETERS
from jaxmpc.swing import WINDOW
from jaxmpc.synthesis.params import Params
from sweeps.goal import SweepGoal
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec
from sweeps.targets import RECORDING

SCHEMA = "jaxmpc-sweep/2"
VELOCITY = "difference of positions"
"""What damping is by, in loops and margins. Before this stood in a spec it was the velocity itself: rows of the two do
not belong in one folder."""
SWINGING = "after settling"
"""What the swing is of where a run ends within 10 s of settling. Before this stood in a spec it was of the beginning of
contact, too: rows of the two do not belong in one folder."""
_SHA = "sha256:"

Columns = dict[str, np.ndarray]
"""Values per name, one row each."""


class Column(NamedTuple):
    """Type and shape of one row's entry."""

    dtype: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """What is to be computed, whoever computes it and in whatever portions; it can be pickled and is small.

    Attributes:
        canonical: The spec as plain data, every default written out, a recording as the hash of its content.
        files: Content of the recordings, by that hash.
        goal: How rows are ranked; no part of the hash.
        engine: Which one runs the rows; None is the fastest where they run. No part of the hash: the environment tells.
    """

    canonical: dict[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)
    goal: SweepGoal = field(default_factory=SweepGoal)
    engine: str | None = None

    def __reduce__(self) -> Any:
        # Without what is cached: the rows of a large sweep are many, and follow from the rest.
        return Plan, (self.canonical, self.files, self.goal, self.engine)

    @cached_property
    def spec_hash(self) -> str:
        """sha256 of the canonical spec; names and places of files are no part of it."""
        return digest(self.canonical)

    @cached_property
    def space(self) -> SweepSpace:
        """The points of the sweep."""
        return msgspec.convert(self.canonical["space"], SweepSpace)

    @cached_property
    def rows(self) -> np.ndarray:
        """Row numbers that are computed, ascending."""
        return self.space.rows()

    @cached_property
    def bounds(self) -> np.ndarray:
        """Places among the planned rows at which another world begins, and the end."""
        worlds = self.rows // self.space.same_world
        return np.append(np.flatnonzero(np.diff(worlds)) + 1, len(worlds))

    @property
    def worlds(self) -> int:
        """How many worlds there are."""
        return len(self.bounds)

    @cached_property
    def base(self) -> Params:
        """The base controller."""
        return Params.from_dict(self.canonical["params"])

    @property
    def kept(self) -> tuple[str, ...]:
        """Metrics and margins that are kept."""
        return tuple(self.canonical["columns"])

    @cached_property
    def stiffness(self) -> tuple[float, ...]:
        """Tissue stiffnesses; NaN where they are swept [N/m]."""
        base = tuple(map(float, self.canonical["experiment"]["stiffness"]))
        axis = next((axis for axis in self.space.axes if axis.name.partition(".")[0] == "stiffness"), None)
        if axis is None:
            return base
        tissues = 1 if axis.numeric and axis.name == "stiffness" and not axis.relative else len(base)
        return (np.nan,) * (tissues if axis.numeric else len(axis.values[0]))

    @cached_property
    def layout(self) -> dict[str, Column]:
        """The columns of the result in their fixed order; what a run measures has the precision of the stepping."""
        measured, tissues = {"float32": "<f4", "float64": "<f8"}[self.canonical["precision"]], len(self.stiffness)
        columns = {"row": Column("<i8", ())} | {axis.name: Column("<f8", ()) for axis in self.space.axes}
        columns["status"] = Column("|i1", (tissues,))
        for name in self.kept:
            metric = name in METRICS
            columns[name] = Column(measured, (tissues, len(AXES))) if metric else Column("<f8", (tissues,))
        return columns

    @cached_property
    def row_bytes(self) -> int:
        """Size of one row of the result [bytes]."""
        return sum(np.dtype(dtype).itemsize * int(np.prod(shape)) for dtype, shape in self.layout.values())

    def hash_of(self, columns: Mapping[str, np.ndarray]) -> str:
        """sha256 over the little-endian bytes of all columns in their fixed order.

        A column of float32 that float64 has corrected counts with all its digits.
        """
        total = hashlib.sha256()
        for name, column in self.layout.items():
            dtype = "<f8" if columns[name].dtype == np.float64 else column.dtype
            values = np.ascontiguousarray(columns[name], np.dtype(dtype))
            total.update(canonical_json([name, dtype, list(values.shape)]).encode())
            total.update(values)
        return total.hexdigest()

    @property
    def largest_chunk(self) -> int:
        """Most rows that a chunk file may have."""
        return LARGEST // 2 // self.row_bytes

    def experiment(self, folder: Path) -> Experiment:
        """The base experiment; recordings are written into a folder first, unless they are there."""
        return Experiment.from_dict(self.with_files(self.canonical["experiment"], folder))

    def with_files(self, experiment: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """An experiment's data whose recording is a file again."""
        data = dict(experiment)
        if (name := data["motion"]["file"]).startswith(_SHA):
            content = self.files[name]
            path = folder / (name.removeprefix(_SHA) + (".npz" if content.startswith(b"PK") else ".csv"))
            if not path.exists():
                write_atomic(path, content)
            data["motion"] = {**data["motion"], "file": str(path)}
        return data


def make_plan(spec: SweepSpec) -> Plan:
    """The plan of a spec; one that has no precision yet is planned in float32.

    Raises:
        InputError: A recording cannot be read, or the experiment leaves nothing to score.
    """
    experiment = spec.experiment.to_dict()
    del experiment["name"]
    _ = spec.experiment.signals
    files: dict[str, bytes] = {}

    def hashed(file: str) -> str:
        content = read_bytes(file, LARGEST_RECORDING, "motion.file")
        name = _SHA + hashlib.sha256(content).hexdigest()
        files[name] = content
        return name

    if file := experiment["motion"]["file"]:
        experiment["motion"]["file"] = hashed(file)
    space = msgspec.to_builtins(spec.space)
    for axis in (axis for factor in space["factors"] for axis in factor if axis["name"] == RECORDING):
        try:
            axis["values"] = [hashed(file) for file in axis["values"]]
        except OSError as error:
            raise InputError(f"sweep.axes.{RECORDING}", error.filename, "readable", f"{error.strerror}.") from None
    canonical = {
        "schema": SCHEMA,
        "experiment": experiment,
        "params": spec.params.to_dict(),
        "precision": spec.precision or "float32",
        "columns": list(spec.kept),
        "space": space,
    }
    swept = {axis.name for axis in spec.space.axes}
    if spec.experiment.physics != "linear" or spec.experiment.damping != "ideal" or swept & {"physics", "damping"}:
        canonical["velocity"] = VELOCITY
    if spec.experiment.physics != "linear" or "physics" in swept:
        short = spec.experiment.duration - spec.experiment.settle < WINDOW or swept & {"duration", "settle"}
        if "swing" in spec.kept and short:
            canonical["swing"] = SWINGING
    # Through JSON types, so that a plan read back from its manifest is the same one.
    return Plan(msgspec.json.decode(msgspec.json.encode(canonical)), files, spec.goal, spec.engine)


def check_chunk(plan: Plan, chunk: int) -> int:
    """Rows of a chunk; one that could not be read back is refused.

    Raises:
        InputError: It is no whole number, not positive or too large.
    """
    return counted("chunk", chunk, "Rows of a file; by default a few seconds of work.", 1, plan.largest_chunk)


def describe(plan: Plan) -> str:
    """What was resolved, for a person."""
    space, experiment = plan.space, plan.canonical["experiment"]
    lines = []
    for factor in space.factors:
        for axis in factor:
            ends = ", ".join(map(axis.label, range(len(axis.values))))
            if axis.numeric:
                low, high = axis.label(min(axis.values)), axis.label(max(axis.values))
                ends = f"{low} … {high} {axis.unit}".removesuffix(" -")
            points = (
                f"{len(axis.values)} values" if space.kind == "grid" or axis.scale in ("list", "choice") else "drawn"
            )
            also = ", times the base" * axis.relative + ", zipped" * (len(factor) > 1)
            lines.append(f"  {axis.name:<11} {ends}, {points}, {axis.scale}{also}")
    swept = {axis.name: axis.values for axis in space.axes}
    fixed = {k: v for k, v in plan.canonical["params"].items() if k not in swept}
    lines.append("  fixed       " + ", ".join(f"{k} {_short(v)}" for k, v in fixed.items() if k in PARAMETERS))
    if not np.isnan(plan.stiffness).any():
        lines.append(f"  stiffness   {', '.join(f'{k:g}' for k in plan.stiffness)} N/m")
    worlds = swept.get("physics", (experiment["physics"],))
    # On the arm it is never ideal, whatever stands there.
    damping = experiment["damping"] if "linear" in worlds else "sampled"
    lines.append(
        f"  experiment  {experiment['physics']}, {experiment['duration']:g} s at {experiment['sampling_time']:g} s,"
        f" {damping} damping, motion {experiment['motion']['kind']}, {plan.canonical['precision']}"
    )
    lines.append(f"  best        {plan.goal.text}")
    return "\n".join(lines)


def _short(value: Any) -> str:
    return f"a diagonal of {len(value)}" if isinstance(value, list) else f"{value}"
