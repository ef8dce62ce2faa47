"""What a report is told: rows with their measures, sentences, tables and charts; not where they come from."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxmpc.quantities import Metric, Parameter, Quantity, Sense

Role = Literal["parameter", "metric", "margin", "other"]
Style = Literal["line", "dash", "dots", "bars"]
TELLING_RATIO = 20.0
"""Largest over smallest value from which an axis is logarithmic at first."""


@dataclass(frozen=True, eq=False)
class Measure:
    """One number of every row, or one of every row and tissue.

    Attributes:
        name: Unlike any other of the report.
        head: Its heading, without the unit.
        unit: In which the values are; "-" where there is none.
        text: What it is, in a few words.
        values: Shape (rows,) or (rows, tissues); NaN where there is none.
        role: What it is for: parameters are chosen, metrics and margins come out.
        sense: Whether a limit bounds it from above, from below, or not at all.
        digits: Decimals in a table; None writes four significant ones.
        limit: A row that does not keep it is no candidate; None where there is no limit.
        whole: Whether it counts.
    """

    name: str
    head: str
    unit: str
    text: str
    values: np.ndarray
    role: Role = "other"
    sense: Sense = "none"
    digits: int | None = None
    limit: float | None = None
    whole: bool = False

    @property
    def logarithmic(self) -> bool:
        """Whether an axis shows it logarithmically at first."""
        finite = self.values[np.isfinite(self.values)]
        return len(finite) > 0 and 0.0 < TELLING_RATIO * float(finite.min()) < float(finite.max())

    @property
    def worst(self) -> np.ndarray:
        """The worst over the tissues, (rows,); NaN where one is."""
        if self.values.ndim == 1:
            return self.values
        found: np.ndarray = (np.min if self.sense == "floor" else np.max)(self.values, axis=1)
        return found

    @property
    def kept(self) -> np.ndarray:
        """Whether each row keeps the limit on every tissue, (rows,)."""
        if self.limit is None:
            return np.ones(len(self.values), bool)
        kept: np.ndarray = self.worst >= self.limit if self.sense == "floor" else self.worst <= self.limit
        return kept


def measure(quantity: Quantity, values: Any, limit: float | None = None) -> Measure:
    """A quantity's values as people read them: in the unit of tables, the worst axis of a metric.

    Args:
        quantity: A row of `jaxmpc.quantities`.
        values: In SI: (rows,) of a parameter, (rows, tissues) of a margin, (rows, tissues, axes) of a metric.
        limit: In SI.
    """
    values = np.asarray(values, float)
    role: Role = "parameter" if isinstance(quantity, Parameter) else "margin"
    if isinstance(quantity, Metric):
        role, values = "metric", quantity.worst(values, axis=-1)
    return Measure(
        quantity.name,
        quantity.head or quantity.name,
        quantity.shown_unit or quantity.unit,
        quantity.text,
        quantity.times * values,
        role,
        quantity.sense,
        None if role == "parameter" else quantity.digits,
        None if limit is None or math.isinf(limit) else quantity.times * limit,
        isinstance(quantity, Parameter) and quantity.whole,
    )


class Series(NamedTuple):
    """A curve, a cloud or the bars of a chart."""

    name: str
    x: Any
    """Numbers, (points,)."""
    y: Any
    """Numbers, (points,); NaN leaves a gap."""
    color: int = 0
    """Which of the page's colours; the same means the same controller throughout a report."""
    style: Style = "line"


class Mark(NamedTuple):
    """A line across a chart, or a point in it."""

    text: str
    x: float | None = None
    y: float | None = None


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over one pair of axes.

    Attributes:
        title: Above it.
        x: Label of the axis across, with its unit.
        y: Label of the axis upwards, with its unit.
        series: What is drawn.
        marks: Lines at an x or a y, points at both.
        x_log: Whether the axis is logarithmic.
        y_log: Whether the axis is logarithmic.
        x_range: What is shown; None fits the curves.
        y_range: What is shown; None fits the curves.
        categories: Names of x = 0, 1, …, for bars.
        square: Whether both axes have one scale.
    """

    title: str
    x: str
    y: str
    series: Sequence[Series]
    marks: Sequence[Mark] = ()
    x_log: bool = False
    y_log: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    categories: Sequence[str] = ()
    square: bool = False


class Table(NamedTuple):
    """A table whose first column names the rows."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    folded: str = ""
    """Where it says too much to stand open, the title that opens it."""


class Section(NamedTuple):
    """A part of the report."""

    title: str
    sentences: Sequence[str]
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()


class Detail(NamedTuple):
    """What a click on a row shows besides its numbers."""

    charts: Sequence[Chart] = ()
    toml: str = ""
    """Its params.toml; empty where that of all rows says it."""


class Swept(NamedTuple):
    """Stands in the params.toml of all rows for the value of one."""

    name: str
    """A parameter's."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """The rows of a report.

    Attributes:
        names: What each row is called.
        measures: Their numbers.
        status: A `jaxmpc.Status` per row and tissue.
        tissues: Names of the tissues.
        goals: Names of the measures that the Pareto front shows first, two or three.
        toml: The params.toml of all rows, in pieces; empty where each has its own.
        details: By place, what is computed beforehand of the rows that matter.
        note: Which rows have details, and what these are.
        influence: By measure, share of its variance that each parameter explains, (parameters, 1 + tissues), the
            worst tissue first; see `jaxmpc.report.influence`.
        group: What the tissues are, where they are something else, such as controllers in the same trial.
        file: What a row's TOML is called.
    """

    names: Sequence[str]
    measures: Sequence[Measure]
    status: np.ndarray
    tissues: Sequence[str]
    goals: Sequence[str]
    toml: Sequence[str | Swept] = ()
    details: Mapping[int, Detail] = field(default_factory=dict)
    note: str = ""
    influence: Mapping[str, np.ndarray] = field(default_factory=dict)
    group: str = "tissue"
    file: str = "params.toml"

    def __len__(self) -> int:
        return len(self.names)

    @property
    def feasible(self) -> np.ndarray:
        """Whether each row is OK on every tissue and keeps every limit, (rows,)."""
        kept: np.ndarray = np.all([(self.status == 0).all(axis=1), *(each.kept for each in self.measures)], axis=0)
        return kept


@dataclass(frozen=True, eq=False)
class Report:
    """A whole report.

    Attributes:
        title: Of the page.
        lead: What it comes to, in sentences.
        rows: What may be explored; None where there is nothing to choose from.
        sections: The rest, in order.
        first: How many sections stand before the rows.
    """

    title: str
    lead: Sequence[str] = ()
    rows: Candidates | None = None
    sections: Sequence[Section] = ()
    first: int = 0
