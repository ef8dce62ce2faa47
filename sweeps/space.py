"""The points of a sweep: row number → parameters, the same whatever else is computed."""

import math
from typing import Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import HORIZONS, PARAMETERS

MOST_ROWS = 10_000_000
"""Largest grid or sample [rows]."""
Scale = Literal["list", "linear", "log"]


class SweepAxis(msgspec.Struct, frozen=True):
    """One swept parameter.

    Attributes:
        name: A key of `jaxmpc.quantities.PARAMETERS`.
        scale: How its values lie; "list" are those that the user wrote out.
        values: The points of a grid or of a list, or the two ends of a range to draw from, in the parameter's unit.
    """

    name: str
    scale: Scale
    values: tuple[float, ...]

    def draw(self, uniform: float) -> float:
        """The value at a place in [0, 1) of the axis."""
        if self.scale == "list":
            return self.values[int(uniform * len(self.values))]
        low, high = self.values
        if self.scale == "log":
            value = math.exp(math.log(low) + uniform * (math.log(high) - math.log(low)))
        else:
            value = low + uniform * (high - low)
        return min(max(round(value) if self.name in HORIZONS else value, low), high)


class SweepSpace(msgspec.Struct, frozen=True):
    """Every row of a sweep.

    A row's number is its index in the full grid, in row-major order of the axes as written, or its index in
    the random sample; its parameters depend on that number alone.

    Attributes:
        kind: Grid or random sample.
        axes: The swept parameters.
        count: Rows of the full grid or of the sample.
        seed: Of the random sample.
        horizons: H_p and H_u where they are not swept [samples].
    """

    kind: Literal["grid", "random"]
    axes: tuple[SweepAxis, ...]
    count: int
    seed: int
    horizons: tuple[float, float]

    def columns(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Values of the swept parameters, each (len(rows),).

        Args:
            rows: Row numbers.
        """
        if self.kind == "random":
            table = np.array([self._drawn(int(row)) for row in rows]).reshape(len(rows), len(self.axes))
            return {axis.name: table[:, i] for i, axis in enumerate(self.axes)}
        places = np.unravel_index(rows, tuple(len(axis.values) for axis in self.axes))
        return {axis.name: np.array(axis.values)[place] for axis, place in zip(self.axes, places, strict=True)}

    def rows(self) -> np.ndarray:
        """Row numbers that are computed: those of a grid with H_u ≤ H_p, all of a random sample."""
        rows = np.arange(self.count)
        swept = {axis.name for axis in self.axes}
        if self.kind == "grid" and swept & set(HORIZONS):
            columns = self.columns(rows)
            fixed = dict(zip(HORIZONS, self.horizons, strict=True))
            rows = rows[columns.get("Hu", fixed["Hu"]) <= columns.get("Hp", fixed["Hp"])]
        return rows

    def _drawn(self, row: int) -> list[float]:
        """One row of the sample, from a counter-based generator of its own; drawn again while H_u > H_p."""
        random = np.random.Generator(np.random.Philox(key=np.array([self.seed, row], np.uint64)))
        while True:
            values = [axis.draw(u) for axis, u in zip(self.axes, random.random(len(self.axes)), strict=True)]
            found = dict(zip(HORIZONS, self.horizons, strict=True))
            found.update((axis.name, value) for axis, value in zip(self.axes, values, strict=True))
            if found["Hu"] <= found["Hp"]:
                return values


def make_axis(name: str, scale: Scale, values: tuple[float, ...], points: int | None) -> SweepAxis:
    """An axis from its description in a spec.

    Args:
        name: The swept parameter.
        scale: "list", or the spacing of a range.
        values: The list, or the two ends of the range, in the parameter's unit.
        points: Points on the range; None keeps its ends, to draw from.

    Raises:
        InputError: A value is not finite or out of bounds, a range is empty or a list repeats itself.
    """
    key = f"sweep.axes.{name}"
    unit, (low, high) = PARAMETERS[name].unit, PARAMETERS[name].bounds
    # One weight δ = 0 is a controller that controls nothing.
    positive = scale == "log" or name == "delta"
    bound = f"above 0 and at most {high:g} {unit}" if positive and low == 0.0 else f"in [{low:g}, {high:g}] {unit}"
    for value in values:
        if not low <= value <= high or (positive and value <= 0.0):
            raise InputError(key, value, bound, f"Correct the values of {name}.")
        if name in HORIZONS and value != int(value):
            raise InputError(key, value, "a whole number of samples", f"Round the values of {name}.")
    if scale == "list":
        if not values:
            raise InputError(key, "[]", "at least one value", "List values, or remove the axis.")
        if len(set(values)) != len(values):
            raise InputError(key, list(values), "free of repetition", "Each row of a sweep exists once.")
        return SweepAxis(name, scale, values)
    first, last = values
    if not first < last:
        raise InputError(key, list(values), "[smallest, largest]", "Swap the ends of the range, or list one value.")
    if points is None:
        return SweepAxis(name, scale, values)
    spaced = np.geomspace(first, last, points) if scale == "log" else np.linspace(first, last, points)
    # Rounding can make neighbours equal; each stays once.
    return SweepAxis(name, scale, tuple(dict.fromkeys((np.round(spaced) if name in HORIZONS else spaced).tolist())))


def make_space(
    kind: Literal["grid", "random"], axes: tuple[SweepAxis, ...], rows: int, seed: int, horizons: tuple[float, float]
) -> SweepSpace:
    """A sweep's space; see `SweepSpace` for the arguments, of which `rows` is used by a random sample only.

    Raises:
        InputError: There are too many rows, or none with H_u ≤ H_p.
    """
    count = math.prod(len(axis.values) for axis in axes) if kind == "grid" else rows
    if count > MOST_ROWS:
        raise InputError("sweep.axes", f"{count} rows", f"at most {MOST_ROWS} rows", "Take fewer points.")
    ends = {name: (value, value) for name, value in zip(HORIZONS, horizons, strict=True)}
    ends.update((axis.name, (min(axis.values), max(axis.values))) for axis in axes)
    if ends["Hu"][0] > ends["Hp"][1]:
        bound = f"in [1, Hp (= {ends['Hp'][1]:g})] samples"
        raise InputError("Hu", f"{ends['Hu'][0]:g} or more", bound, "Lower Hu or raise Hp: no row is left.")
    return SweepSpace(kind, axes, count, seed, horizons)
