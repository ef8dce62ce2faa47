"""A spec with everything resolved: its canonical form, its hash, and what each row holds."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import LARGEST_RECORDING, read_bytes
from jaxmpc.files.sealed import LARGEST, digest
from jaxmpc.quantities import AXES, MARGINS, METRICS, PARAMETERS
from jaxmpc.synthesis.params import Params
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec

SCHEMA = "jaxmpc-sweep/1"
CHUNK = 2048
"""Rows of a chunk file, the most that a kill can cost."""


Columns = dict[str, np.ndarray]
"""Values per name, one row each."""


class Column(NamedTuple):
    """Type and shape of one row's entry."""

    dtype: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """What is to be computed, whoever computes it and in whatever portions.

    Attributes:
        canonical: The spec as plain data, every default written out, a recording as the hash of its content.
    """

    canonical: dict[str, Any]

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
    def base(self) -> Params:
        """The base controller."""
        return Params.from_dict(self.canonical["params"])

    @property
    def stiffness(self) -> tuple[float, ...]:
        """Tissue stiffnesses [N/m]."""
        return tuple(self.canonical["experiment"]["stiffness"])

    @cached_property
    def layout(self) -> dict[str, Column]:
        """The columns of the result in their fixed order."""
        return layout(self.space, len(self.stiffness), self.canonical["precision"])

    @cached_property
    def row_bytes(self) -> int:
        """Size of one row of the result [bytes]."""
        return sum(np.dtype(dtype).itemsize * int(np.prod(shape)) for dtype, shape in self.layout.values())

    def params(self, first: int, last: int) -> Params:
        """The controllers of the planned rows first … last − 1, as a batch."""
        return self.base.with_columns(self.space.columns(self.rows[first:last]))

    def portions(self, missing: np.ndarray, chunk: int) -> Iterator[tuple[int, int]]:
        """Stretches of at most `chunk` rows that cover the missing ones.

        Args:
            missing: Whether each planned row is missing.
            chunk: Rows of a portion.
        """
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
        for begin, end in edges.reshape(-1, 2).tolist():
            for first in range(begin, end, chunk):
                yield first, min(first + chunk, end)


def layout(space: SweepSpace, tissues: int, precision: str) -> dict[str, Column]:
    """The columns of a result in their fixed order.

    Args:
        space: The points of the sweep.
        tissues: How many stiffnesses each is run on.
        precision: Of the time stepping: what a run measures has it, margins are always float64.
    """
    measured = {"float32": "<f4", "float64": "<f8"}[precision]
    columns = {"row": Column("<i8", ())} | {axis.name: Column("<f8", ()) for axis in space.axes}
    columns["status"] = Column("|i1", (tissues,))
    columns |= {name: Column(measured, (tissues, len(AXES))) for name in METRICS}
    columns |= {name: Column("<f8", (tissues,)) for name in MARGINS}
    return columns


def make_plan(spec: SweepSpec) -> Plan:
    """The plan of a spec.

    Raises:
        InputError: The recording cannot be read, or the experiment leaves nothing to score.
    """
    experiment = spec.experiment.to_dict()
    del experiment["name"]
    _ = spec.experiment.signals
    if file := experiment["motion"]["file"]:
        experiment["motion"]["file"] = (
            "sha256:" + hashlib.sha256(read_bytes(file, LARGEST_RECORDING, "motion.file")).hexdigest()
        )
    canonical = {
        "schema": SCHEMA,
        "experiment": experiment,
        "params": spec.params.to_dict(),
        "precision": spec.precision,
        "space": msgspec.to_builtins(spec.space),
    }
    # Through JSON types, so that a plan read back from its manifest is the same one.
    return Plan(msgspec.json.decode(msgspec.json.encode(canonical)))


def check_chunk(plan: Plan, chunk: int) -> None:
    """Refuse a chunk that could not be read back.

    Raises:
        InputError: It is not positive or too large.
    """
    most = LARGEST // 2 // plan.row_bytes
    if not 1 <= chunk <= most:
        raise InputError("chunk", chunk, f"in [1, {most}] rows", f"Its default is {CHUNK}.")


def describe(plan: Plan) -> str:
    """What was resolved, for a person."""
    space, experiment = plan.space, plan.canonical["experiment"]
    swept = {axis.name: axis for axis in space.axes}
    lines = []
    for name, axis in swept.items():
        ends = f"{min(axis.values):.6g} … {max(axis.values):.6g} {PARAMETERS[name].unit}"
        points = f"{len(axis.values)} values" if space.kind == "grid" or axis.scale == "list" else "drawn"
        lines.append(f"  {name:<11} {ends}, {points}, {axis.scale}")
    fixed = {k: v for k, v in plan.canonical["params"].items() if k not in swept}
    lines.append("  fixed       " + ", ".join(f"{k} {_short(v)}" for k, v in fixed.items()))
    lines.append(f"  stiffness   {', '.join(f'{k:g}' for k in plan.stiffness)} N/m")
    lines.append(
        f"  experiment  {experiment['duration']:g} s at {experiment['sampling_time']:g} s, {experiment['damping']}"
        f" damping, motion {experiment['motion']['kind']}, {plan.canonical['precision']}"
    )
    return "\n".join(lines)


def _short(value: Any) -> str:
    return f"a diagonal of {len(value)}" if isinstance(value, list) else f"{value}"
