"""Rows of a sweep as aligned text."""

from collections.abc import Sequence

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from sweeps.goal import MEASURED, ON_ARM
from sweeps.result import Result
from sweeps.sensitivity import sensitivity

COLUMNS = ("rms", "true_rms", *MARGINS)
"""Shown of every row, where they were kept, beside what ranks and limits it."""


def rows_table(result: Result, title: str, goals: Sequence[str] = ()) -> str:
    """Rows in the order given: number, what was swept, and each quantity at its worst over stiffness and axis."""
    if not len(result):
        return f"{title}: no row"
    names = dict.fromkeys((*goals, *result.goal.names, *COLUMNS))
    shown = [name for name in names if name in result.plan.kept]
    lines = [["row", *(_heading(axis.name, axis.unit) for axis in result.axes), *(MEASURED[n].heading for n in shown)]]
    values = {name: result.worst(name) for name in shown}
    for place in range(len(result)):
        swept = [axis.label(float(result[axis.name][place])) for axis in result.axes]
        absent = _not_measured(result, place)
        found = [
            "–" if name in absent else f"{MEASURED[name].times * values[name][place]:.4g}".replace("inf", "∞")
            for name in shown
        ]
        lines.append([str(result["row"][place]), *swept, *found])
    return "\n".join([f"{title}; worst over stiffness and axis", *aligned(lines)])


def row_sheet(result: Result) -> str:
    """All of one row: what was set, and every quantity on every tissue."""
    lines = [f"row {result['row'][0]}, {'good' if result.feasible[0] else 'not good'}: {result.goal.text}"]
    for axis in result.axes:
        unit = "" if axis.unit == "-" else f" {axis.unit}"
        lines.append(f"  {axis.name} = {axis.label(float(result[axis.name][0]))}{unit}")
    table = [["", *(f"{stiffness:g} N/m" for stiffness in result.tissues[0])]]
    table.append(["status", *(Status(int(status)).name for status in result["status"][0])])
    absent = _not_measured(result, 0)
    for name in result.plan.kept:
        quantity = MEASURED[name]
        for i, axis_name in enumerate(AXES if name in METRICS else ("",)):
            cells = result[name][0, :, i] if name in METRICS else result[name][0]
            entries = ["–" if name in absent else quantity.entry(cell) for cell in cells]
            table.append([f"{quantity.heading} {axis_name}".rstrip(), *entries])
    return "\n".join([*lines, *aligned(table)])


def sensitivity_table(result: Result) -> str:
    """How much each axis matters, for what ranks and for what is limited."""
    lines = [["", *(text for name in result.goal.names for text in (f"{name}: share", "rank corr."))]]
    found = {name: sensitivity(result, name) for name in result.goal.names}
    for axis in result.axes:
        cells = [found[name][axis.name] for name in result.goal.names]
        texts = [text for cell in cells for text in (f"{100 * cell.share:.1f} %", _correlation(cell.correlation))]
        lines.append([axis.name, *texts])
    title = "share of the variance of each quantity's logarithm that an axis explains alone, and Spearman's correlation"
    ok, rows = int(np.sum(result.ok)), len(result)
    title += f"; {ok} of {rows} rows are OK everywhere"
    if ok < rows:
        title += ": shares are of all, what was lost counted as bad, correlations of what has a number"
    return "\n".join([title, *aligned(lines)])


def _correlation(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:+.2f}"


def aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table with columns of one width, the first to the left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [
        "  ".join(
            word.ljust(width) if i == 0 else word.rjust(width)
            for i, (word, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]


def _not_measured(result: Result, place: int) -> frozenset[str]:
    """What the run of a row does not measure."""
    swept = [axis for axis in result.axes if axis.name == "physics"]
    physics = [axis.values[int(result["physics"][place])] for axis in swept]
    base = result.plan.canonical["experiment"]["physics"]
    return ON_ARM if [*physics, base][0] == "linear" else frozenset()


def _heading(name: str, unit: str) -> str:
    return name if unit == "-" else f"{name} [{unit}]"
