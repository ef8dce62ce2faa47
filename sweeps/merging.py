"""Rows of several sweeps of the same axes as those of one."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from sweeps.axis import SweepAxis
from sweeps.plan import Columns, Plan
from sweeps.space import SweepSpace

Rows = tuple[Plan, Mapping[str, np.ndarray]]
"""A plan, and columns of it."""


def merge(parts: Sequence[Rows]) -> tuple[Plan, Columns]:
    """All rows in order, numbered by where they stand among all planned ones, and a plan that writes these out.

    Args:
        parts: At least one; rows that are planned and not there yet have their numbers, too.
    """
    first, all_columns = parts[0][0], [columns for _, columns in parts]
    columns = {name: np.concatenate([each[name] for each in all_columns]) for name in all_columns[0]}
    planned = np.cumsum([0, *(len(plan.rows) for plan, _ in parts)])
    columns["row"] = np.concatenate(
        [begin + np.searchsorted(plan.rows, own["row"]) for begin, (plan, own) in zip(planned[:-1], parts, strict=True)]
    )
    factor = tuple(_joined(axis.name, parts) for axis in first.space.axes)
    columns |= {axis.name: _places(axis)[columns["row"]] for axis in factor}
    space = SweepSpace("grid", (factor,), int(planned[-1]), 0, first.space.horizons)
    canonical = {**first.canonical, "space": msgspec.to_builtins(space)}
    return Plan(msgspec.json.decode(msgspec.json.encode(canonical)), first.files, first.goal), columns


def _places(axis: SweepAxis) -> np.ndarray:
    """Its column; rows of one choice have one place, the first at which it stands."""
    if axis.numeric:
        return axis.column()
    first: dict[bytes, int] = {}
    return np.array([float(first.setdefault(msgspec.json.encode(v), i)) for i, v in enumerate(axis.values)])


def _joined(name: str, parts: Sequence[Rows]) -> SweepAxis:
    """An axis whose points are those of every planned row, in order."""
    values: list[Any] = []
    labels: list[str] = []
    for plan, columns in parts:
        axis = next(axis for axis in plan.space.axes if axis.name == name)
        entries = _planned(plan, columns, name).tolist()
        values += entries if axis.numeric else [axis.values[int(entry)] for entry in entries]
        labels += [axis.labels[int(entry)] for entry in entries] if axis.labels else []
    return SweepAxis(name, axis.scale, tuple(values), axis.relative, tuple(labels))


def _planned(plan: Plan, columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Entries of an axis in every planned row: as they were kept where a row is there, so that no bit of it changes."""
    if len(columns[name]) == len(plan.rows):
        return columns[name]
    entries = plan.space.columns(plan.rows)[name]
    entries[np.searchsorted(plan.rows, columns["row"])] = columns[name]
    return entries
