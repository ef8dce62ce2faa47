"""Tables on the terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxmpc.evaluation import Outcome
    from jaxmpc.experiment import Experiment


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table: framed on a terminal, plain columns in a pipe."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold", pad_edge=False)
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # Piped output has no width of its own; cutting columns to 80 would lose numbers.
    console = Console()
    Console(width=console.width if console.is_terminal else 140, highlight=False).print(table)


def number(value: Any, digits: int = 3) -> str:
    """A figure for a table; – where there is none, ∞ where there is no limit."""
    value = float(value)
    if np.isnan(value):
        return "–"
    return "∞" if np.isinf(value) else f"{value:.{digits}f}"


def residual_rows(label: str, outcome: "Outcome", experiment: "Experiment") -> list[list[str]]:
    """One row per stiffness: residual per axis, margins and status."""
    from jaxmpc.status import Status

    rows = []
    for i, stiffness in enumerate(experiment.stiffness):
        pairs = zip(outcome.metrics.peak_to_peak[i], outcome.metrics.rms[i], strict=True)
        residuals = [f"{number(pp, 2)} / {number(rms)}" for pp, rms in pairs]
        found = outcome.margins
        margins = [
            number(found.M_s[i], 2),
            f"{number(found.gain_margin_db[i], 1)} / −{number(found.gain_reduction_db[i], 1)}",
            number(found.phase_margin_deg[i], 0),
            number(1e3 * found.delay_margin_s[i], 1),
        ]
        rows.append([label, f"{stiffness:g}", *residuals, *margins, Status(int(outcome.status[i])).name])
    return rows


RESIDUAL_HEADER = (
    "controller",
    "K_s N/m",
    "X pp/RMS N",
    "Y pp/RMS N",
    "Z pp/RMS N",
    "M_s",
    "GM dB",
    "PM °",
    "DM ms",
    "status",
)
