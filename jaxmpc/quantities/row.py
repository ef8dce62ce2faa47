"""A row of the table of quantities: a number's name, unit, text, symbol, sense, and how it is shown."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np

Sense = Literal["ceiling", "floor", "none"]
SearchRange = tuple[float, float, float]
"""Lowest and highest value, and the change per unit of a search's variable: in the logarithm, or in samples."""


@dataclass(frozen=True)
class Quantity:
    """A number with a name, the same in every file, table and goal."""

    name: str
    unit: str
    """SI; "-" where there is none."""
    text: str
    """A few words that explain it."""
    symbol: str
    """As matplotlib sets it."""
    sense: Sense = "ceiling"
    """How a limit bounds it: from above, from below, or not at all."""
    head: str = ""
    """Its heading in a table, without the unit."""
    shown_unit: str = ""
    """Unit in a table, where that is another one."""
    times: float = 1.0
    """A value times this is in the unit of a table."""
    digits: int = 2
    """Decimals in a table."""
    limits: tuple[float, float] = field(default=(0.0, math.inf), kw_only=True)
    """Above which, and up to which, a limit of it means something: below nothing keeps a ceiling, beyond nothing misses
    it; of a floor the other way about."""

    @property
    def label(self) -> str:
        """Text, symbol and unit, for the axis of a figure."""
        return f"{self.text} {self.symbol} [{self.unit}]"

    @property
    def heading(self) -> str:
        """Heading and unit of a column."""
        unit = self.shown_unit or self.unit
        return f"{self.head or self.name}{'' if unit == '-' else f' [{unit}]'}"

    @property
    def ceiling(self) -> bool:
        """Whether a limit bounds it from above."""
        return self.sense == "ceiling"

    @property
    def sign(self) -> str:
        """How it stands to its limit where that is kept: ≤ or ≥."""
        return "≤" if self.ceiling else "≥"

    def entry(self, value: Any) -> str:
        """A value in a table; – where there is none, ∞ where there is no limit."""
        value = self.times * float(value)
        if math.isnan(value):
            return "–"
        return "∞" if math.isinf(value) else f"{value:.{self.digits}f}"

    def amount(self, value: Any, digits: str = "g") -> str:
        """A value with its unit."""
        unit = {"-": "", "deg": "°"}.get(self.unit, f" {self.unit}")
        return f"{value:{digits}}{unit}"

    def worst(self, values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> Any:
        """The value that is farthest from keeping a limit; NaN where one is."""
        return np.max(values, axis=axis) if self.ceiling else np.min(values, axis=axis)

    def kept(self, value: Any, limit: Any) -> Any:
        """Whether a value keeps a limit; never so where it is not a number."""
        return value <= limit if self.ceiling else value >= limit


@dataclass(frozen=True)
class Metric(Quantity):
    """What a run measures, per tissue and axis."""

    spectral: bool = False
    """Whether a spectrum tells it."""
    crest: float = 1.0
    """Its usual ratio to the residual's RMS, where that stands in for it; a weight, no more."""
    follows: str = "rms"
    """The metric that a spectrum tells and that it grows with, where spectra are corrected by runs."""
    arm_only: bool = False
    """Whether it is of joints, which the linear loop has not: there it is 0."""
    float32_error: float = 0.2
    """Largest relative difference between float32 and float64 of a row's worst value, where M_s ≤ 3, 4 s or more are
    scored and no torque limit acts [-]; see `sweeps.undecided`."""


@dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """What a controller is designed from."""

    sense: Sense = "none"
    bounds: tuple[float, float]
    """Smallest and largest accepted value."""
    search: SearchRange
    """In a search, where nobody says otherwise."""
    search_of_order: Mapping[int, SearchRange] = field(default_factory=dict)
    """The same for an active state of higher order, where that differs."""
    free: bool = True
    """Whether a search moves it unless told otherwise."""
    whole: bool = False
    """Whether it counts samples."""
    entries: int = 0
    """Length of the diagonal that may stand for the number; 0 where none may."""


Row = TypeVar("Row", bound=Quantity)


def table(*rows: Row) -> Mapping[str, Row]:
    """Rows by their names."""
    return MappingProxyType({row.name: row for row in rows})
