"""The table of a comparison: every quantity of every contender, and differences with their interval."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxmpc.quantities import AXES, MARGINS, METRICS, Quantity
from jaxmpc.report.comparison import Comparison
from jaxmpc.report.content import Table

CONFIDENCE = 0.95
"""Probability that an interval of differences holds the mean [-]."""
PER_AXIS = ("rms", "true_rms", "peak_to_peak", "true_peak_to_peak")
"""Metrics that are shown on every axis; of the others the worst."""
KNOWN = "stiffness known: "
"""Before the margins of families whose schedule has the control."""


class Entry(NamedTuple):
    """One row of the table."""

    quantity: Quantity
    label: str
    """What it is; with its unit."""
    place: str
    """Tissue and axis."""
    values: np.ndarray
    """One of every contender, on the experiment itself, (contenders,)."""
    drawn: np.ndarray | None
    """On the drawn motions, (contenders, seeds), NaN where one was lost; None where no motion matters."""


class PairedDifference(NamedTuple):
    """How much more one has than the first, over the same motions."""

    mean: float
    half_width: float
    """Half of the interval in which the mean lies with `CONFIDENCE`; NaN of a single pair."""
    pairs: int
    """Motions on which neither was lost."""
    motions: int

    @property
    def told(self) -> bool:
        """Whether zero lies outside the interval. Where a motion was lost nothing is told of the mean over all."""
        return self.pairs == self.motions and abs(self.mean) > self.half_width


def table(found: Comparison) -> Table:
    """One row per quantity, tissue and axis: every contender, then every other minus the first with its interval."""
    names = [one.name for one in found.contenders]
    head = ["", "K_s, axis", *names, *(f"{name} − {names[0]}" for name in names[1:])]
    rows = []
    for entry in entries(found):
        cells = [entry.quantity.entry(value) for value in entry.values]
        rows.append([entry.label, entry.place, *cells, *_differences(entry)])
    return Table(head, rows)


def difference(first: np.ndarray, other: np.ndarray) -> PairedDifference:
    """Paired difference over motions that both held, with its Student interval.

    Args:
        first: (seeds,).
        other: (seeds,).
    """
    from scipy.stats import t

    apart = (other - first)[np.isfinite(other - first)]
    if not len(apart):
        return PairedDifference(np.nan, np.nan, 0, len(first))
    if len(apart) == 1:
        return PairedDifference(float(apart[0]), np.nan, 1, len(first))
    spread = float(np.std(apart, ddof=1)) / np.sqrt(len(apart))
    half_width = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(apart) - 1)) * spread
    return PairedDifference(float(apart.mean()), half_width, len(apart), len(first))


def entries(found: Comparison) -> Iterator[Entry]:
    """Every row of the table."""
    tissues = [f"{K_s:g} N/m" for K_s in found.experiment.stiffness]
    for name, metric in METRICS.items():
        values = np.stack([np.asarray(getattr(one.metrics, name)) for one in found.outcomes])
        drawn = found.held(name)
        if not any(np.nan_to_num(each).any() for each in (values, drawn) if each is not None):
            continue
        for i, tissue in enumerate(tissues):
            if name in PER_AXIS:
                for a, axis in enumerate(AXES):
                    place = f"{tissue}, {axis.upper()}"
                    over = None if drawn is None else drawn[:, :, i, a]
                    yield Entry(metric, metric.heading, place, values[:, i, a], over)
            else:
                over = None if drawn is None else metric.worst(drawn[:, :, i], axis=-1)
                yield Entry(metric, metric.heading, tissue, metric.worst(values[:, i], axis=-1), over)
    for name, margin in MARGINS.items():
        values = np.stack([np.asarray(getattr(one.margins, name)) for one in found.outcomes])
        for i, tissue in enumerate(tissues):
            yield Entry(margin, margin.heading, tissue, values[:, i], None)
    if any(each is not None for each in found.known):
        nothing = np.full(len(tissues), np.nan)
        for name, margin in MARGINS.items():
            values = np.stack([nothing if each is None else np.asarray(getattr(each, name)) for each in found.known])
            for i, tissue in enumerate(tissues):
                yield Entry(margin, KNOWN + margin.heading, tissue, values[:, i], None)
    if found.ratios is not None:
        ratio = Quantity("limit_ratio", "-", "residual over the least of any linear law", "", head="× limit")
        for i, tissue in enumerate(tissues):
            for a, axis in enumerate(AXES):
                yield Entry(ratio, ratio.heading, f"{tissue}, {axis.upper()}", found.ratios[:, i, a], None)


def _differences(entry: Entry) -> Iterator[str]:
    """Every other's difference to the first; without drawn motions that of the values."""
    times, digits = entry.quantity.times, entry.quantity.digits
    for k in range(1, len(entry.values)):
        if entry.drawn is None:
            apart = times * (entry.values[k] - entry.values[0])
            yield _signed(apart, digits) if np.isfinite(apart) else "–"
            continue
        found = difference(entry.drawn[0], entry.drawn[k])
        if not np.isfinite(found.mean):
            yield "–"
            continue
        interval = f" ± {times * found.half_width:.{digits}f}" if np.isfinite(found.half_width) else ""
        counted = "" if found.pairs == found.motions else f" ({found.pairs} of {found.motions})"
        yield f"{_signed(times * found.mean, digits)}{interval}{' *' if found.told else ''}{counted}"


def _signed(value: float, digits: int) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")
