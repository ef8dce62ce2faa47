"""Tables on the terminal."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpc.quantities import AXES, MARGINS, METRICS
from jaxmpc.terminal import layout

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome
    from jaxmpc.experiment import Experiment


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], keys: int = 1) -> None:
    """Print a table that fits the terminal.

    Args:
        title: Printed above it, unless empty.
        header: Headings.
        rows: Cells.
        keys: Leading columns that say what a row is about.
    """
    text = layout.table(header, rows, keys=keys)
    sys.stdout.write(f"{title}\n\n{text}\n\n" if title else f"\n{text}\n\n")


def number(value: Any, digits: int = 3) -> str:
    """A figure for a table; – where there is none, ∞ where there is no limit."""
    value = float(value)
    if np.isnan(value):
        return "–"
    return "∞" if np.isinf(value) else f"{value:.{digits}f}"


def residual_rows(label: str, outcome: "Outcome", experiment: "Experiment") -> list[list[str]]:
    """Two rows per stiffness: measured residual per axis, margins and status; below it the true residual."""
    from jaxmpc.status import Status

    found, rows = outcome.metrics, []
    for i, stiffness in enumerate(experiment.stiffness):
        margins = [row.entry(getattr(outcome.margins, name)[i]) for name, row in MARGINS.items()]
        status = Status(int(outcome.status[i])).name
        rows.append([label, f"{stiffness:g}", *_residuals(found.peak_to_peak[i], found.rms[i]), *margins, status])
        true = _residuals(found.true_peak_to_peak[i], found.true_rms[i])
        rows.append(["  true force", f"{stiffness:g}", *true, *([""] * (len(margins) + 1))])
    return rows


def _residuals(spans: Any, rms: Any) -> list[str]:
    return [f"{number(pp, 2)} / {number(root)}" for pp, root in zip(spans, rms, strict=True)]


RESIDUAL_HEADER = (
    "controller",
    "K_s N/m",
    *(f"{axis.upper()} pp/RMS [N]" for axis in AXES),
    *(margin.heading for margin in MARGINS.values()),
    "status",
)


def metric_rows(outcome: "Outcome", experiment: "Experiment") -> list[list[str]]:
    """One row per metric: its three axes on each stiffness, see `metric_header`; – where there are no joints."""
    rows = []
    linear = experiment.physics == "linear"
    for name, metric in METRICS.items():
        cells = getattr(outcome.metrics, name)[: len(experiment.stiffness)]
        each = (" / ".join("–" if linear and metric.arm_only else metric.entry(x) for x in axes) for axes in cells)
        rows.append([metric.heading, *each])
    return rows


def metric_header(experiment: "Experiment") -> list[str]:
    """Headings of `metric_rows`."""
    return ["metric", *(f"{stiffness:g} N/m" for stiffness in experiment.stiffness)]
