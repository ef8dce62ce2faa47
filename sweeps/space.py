"""The points of a sweep: row number → an entry for every axis, the same whatever else is computed."""

import math
from collections.abc import Mapping
from functools import reduce
from typing import Any, Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import HORIZONS
from sweeps.axis import SweepAxis, uniforms

MOST_ROWS = 10_000_000
"""Largest grid or sample [rows]."""
_TRIES = 1000
"""How often a row of a sample is drawn again before the horizons are said to be at fault."""

SpaceKind = Literal["grid", "random", "sobol"]
Factor = tuple[SweepAxis, ...]
"""Axes that advance together: of a grid they are equally long, of a sample drawn from one number."""


class SweepSpace(msgspec.Struct, frozen=True):
    """Every row of a sweep.

    A row's number is its index in the full grid, in row-major order of the factors, or its index in the sample; its
    entries depend on that number alone. Factors that change the world stand first, so that rows of one world are
    neighbours.

    Attributes:
        kind: Grid, random sample, or Sobol sequence (scrambled).
        factors: What is multiplied; each is one axis or several zipped.
        count: Rows of the full grid or of the sample.
        seed: Of the sample.
        horizons: H_p and H_u where they are not swept [samples].
        only: Numbers of the rows that are wanted, ascending; None is all.
    """

    kind: SpaceKind
    factors: tuple[Factor, ...]
    count: int
    seed: int
    horizons: tuple[float, float]
    only: tuple[int, ...] | None = None

    @property
    def axes(self) -> tuple[SweepAxis, ...]:
        """Every swept parameter."""
        return tuple(axis for factor in self.factors for axis in factor)

    @property
    def shape(self) -> tuple[int, ...]:
        """Points of each factor of a grid."""
        return tuple(len(factor[0].values) for factor in self.factors)

    @property
    def of_worlds(self) -> bool:
        """Whether any axis changes the world."""
        return any(axis.of_world for axis in self.axes)

    @property
    def same_world(self) -> int:
        """How many neighbours in number share a world: 1 in a sample that varies it."""
        if not self.of_worlds:
            return self.count
        if self.kind != "grid":
            return 1
        apart = zip(self.factors, self.shape, strict=True)
        return math.prod(n for factor, n in apart if not any(axis.of_world for axis in factor))

    def columns(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Entries of the axes, each (len(rows),): numbers, or places among the values of a choice.

        Args:
            rows: Row numbers.
        """
        if self.kind != "grid":
            table = self._sample()
            return {name: values[rows] for name, values in table.items()}
        places = np.unravel_index(rows, self.shape)
        return {
            axis.name: axis.column()[place]
            for factor, place in zip(self.factors, places, strict=True)
            for axis in factor
        }

    def rows(self) -> np.ndarray:
        """Row numbers that are computed, ascending: those with H_u ≤ H_p, and only the wanted ones."""
        rows = np.arange(self.count) if self.only is None else np.array(self.only, np.int64)
        if self.kind != "random" and {axis.name for axis in self.axes} & set(HORIZONS):
            rows = rows[~self.crossed(self.columns(rows))]
        return rows

    def crossed(self, columns: Mapping[str, np.ndarray]) -> Any:
        """Where H_u exceeds H_p: (rows,), or of all rows alike a single value where neither is swept."""
        fixed = dict(zip(HORIZONS, self.horizons, strict=True))
        return columns.get("Hu", fixed["Hu"]) > columns.get("Hp", fixed["Hp"])

    def _sample(self) -> dict[str, np.ndarray]:
        """The whole sample; rows of a random one with H_u > H_p are drawn again, each on its own account."""
        assert self.kind != "grid"
        if self.kind == "sobol":
            return self._entries(uniforms("sobol", self.count, len(self.factors), self.seed))
        found = self._entries(uniforms("random", self.count, len(self.factors), self.seed))
        for attempt in range(1, _TRIES):
            wrong = np.broadcast_to(self.crossed(found), self.count)
            if not wrong.any():
                break
            stream = np.random.Philox(self.seed).jumped(attempt)
            again = self._entries(np.random.Generator(stream).random((self.count, len(self.factors))))
            found = {name: np.where(wrong, again[name], values) for name, values in found.items()}
        return found

    def _entries(self, table: np.ndarray) -> dict[str, np.ndarray]:
        return {axis.name: axis.draw(table[:, i]) for i, factor in enumerate(self.factors) for axis in factor}


def make_space(
    kind: SpaceKind, factors: tuple[Factor, ...], rows: int, seed: int, horizons: tuple[float, float]
) -> SweepSpace:
    """A sweep's space; see `SweepSpace` for the arguments, of which `rows` is used by a sample only.

    Raises:
        InputError: An axis stands twice, zipped axes differ in length, there are too many rows, or none with H_u ≤ H_p.
    """
    axes = [axis for factor in factors for axis in factor]
    names = [axis.name for axis in axes]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"sweep.axes.{twice}", "swept twice", "swept once", "Remove one of the two.")
    for part in names:
        if whole := next((name for name in names if part.startswith(f"{name}.")), None):
            raise InputError(f"sweep.axes.{part}", f"part of {whole}", "swept once", "Remove one of the two.")
    for factor in factors if kind == "grid" else ():
        lengths = {axis.name: len(axis.values) for axis in factor}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{name}: {length}" for name, length in lengths.items())
            raise InputError("sweep.zip", found, "equally long", "Zipped axes advance together, point by point.")
    # Stable: what the user wrote first stays first among the worlds and among the controllers.
    ordered = tuple(sorted(factors, key=lambda factor: not any(axis.of_world for axis in factor)))
    count = reduce(lambda n, factor: n * len(factor[0].values), factors, 1) if kind == "grid" else rows
    if count > MOST_ROWS:
        raise InputError("sweep.axes", f"{count} rows", f"at most {MOST_ROWS} rows", "Take fewer points.")
    ends = {name: (value, value) for name, value in zip(HORIZONS, horizons, strict=True)}
    ends.update((axis.name, (min(axis.values), max(axis.values))) for axis in axes if axis.name in HORIZONS)
    if ends["Hu"][0] > ends["Hp"][1]:
        bound = f"in [1, Hp (= {ends['Hp'][1]:g})] samples"
        raise InputError("Hu", f"{ends['Hu'][0]:g} or more", bound, "Lower Hu or raise Hp: no row is left.")
    space = SweepSpace(kind, ordered, count, seed, horizons)
    if kind != "random" and count <= 1_000_000 and not len(space.rows()):
        raise InputError("Hu", "above Hp in every row", "at most Hp somewhere", "Lower Hu or raise Hp.")
    if kind == "random" and set(names) & set(HORIZONS) and np.any(space.crossed(space._sample())):
        raise InputError("Hu", "hardly ever at most Hp", "so more often", "Lower Hu or raise Hp.")
    return space
