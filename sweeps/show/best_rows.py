"""The best rows of a sweep as a table, on a page or as text."""

from typing import Any

from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.terminal import layout
from sweeps.goal import SweepGoal
from sweeps.result import AROUND, Result
from sweeps.show.in_the_way import in_the_way

RESIDUALS = ("rms", "true_rms")
"""As the sensor reads it, which is what ranks, and of the force itself."""


def table(result: Result, n: int = 10, max_M_s: float | None = None) -> str:
    """The best rows as aligned text: swept parameters, worst-case residual and margins.

    Args:
        result: The sweep.
        n: Rows at most.
        max_M_s: Largest accepted worst-case peak sensitivity [-]; None is the spec's.
    """
    head, lines = rendered(result, n, max_M_s)
    if not lines:
        goal = goal_of(result, max_M_s)
        return "\n".join([f"no row: {goal.text}, at every stiffness", *in_the_way(result, goal)])
    return f"{caption(result, max_M_s)}\n\n{layout.table(head, lines)}"


def caption(result: Result, max_M_s: float | None) -> str:
    """What the table of the best rows shows."""
    return f"best rows: {goal_of(result, max_M_s).text}; RMS, M_s and margins are the worst over stiffness (and axis)"


def rendered(result: Result, n: int, max_M_s: float | None) -> tuple[list[str], list[list[str]]]:
    """Headings and lines of the table of the best rows."""
    best = result.best(n, max_M_s)
    swept = result.axes
    residuals = [name for name in RESIDUALS if name in result.columns]
    margins = {name: margin for name, margin in MARGINS.items() if name in result.columns}
    shown = [*(METRICS[name] for name in residuals), *margins.values()]
    units = ("" if axis.unit == "-" else f" [{axis.unit}]" for axis in swept)
    head = ["row", *(axis.name + unit for axis, unit in zip(swept, units, strict=True))]
    head += [quantity.heading for quantity in shown]
    columns: list[Any] = []
    columns += [METRICS[name].times * best[name].max(axis=(1, 2)) for name in residuals]
    columns += [margin.times * margin.worst(best[name], axis=1) for name, margin in margins.items()]
    lines = []
    for k, row in enumerate(best["row"]):
        settings = [axis.label(float(best[axis.name][k])) for axis in swept]
        lines.append([f"{row}", *settings, *(f"{column[k]:.4g}".replace("inf", "∞") for column in columns)])
    return head, lines


def progress(result: Result) -> str:
    """How many of its rows are here, in words; of a refined sweep those of the stage that is shown."""
    rows = f"{len(result)} of {len(result.plan.rows)} rows"
    if result.stages:
        name, _ = result.stages[-1]
        rows += f" {'up to' if name.endswith(AROUND) else 'of'} stage {name}"
    return rows if result.decided is None else f"{rows}, {result.decided.there}"


def chance(result: Result, max_M_s: float | None = None) -> list[str]:
    """What float64 has decided of a float32 sweep and what is left to chance, in sentences; none where that is nothing.

    Args:
        result: The sweep.
        max_M_s: Largest accepted worst-case peak sensitivity [-]; None is the spec's.
    """
    decided = result.decided
    lines = [decided.sentence(result.goal)] if decided is not None and len(decided.after["row"]) else []
    if left := len(result.undecided(goal_of(result, max_M_s))):
        told = f"{left} rows{' more' * len(lines)} have a rank or status that is chance in float32"
        lines.append(f"{told}; {_remedy(result, max_M_s)}")
    return lines


def _remedy(result: Result, max_M_s: float | None) -> str:
    """What decides the rows that are left to chance."""
    if result.stages and all(stage.plan is not result.plan for _, stage in result.stages):
        return 'each round ran in float64 what is chance among its own rows, precision = "float64" in [sweep] runs all'
    if goal_of(result, max_M_s) != result.goal:
        return "those that are chance with the spec's own limit run in float64"
    return "`decide` in [sweep] bounds how many run in float64"


def goal_of(result: Result, max_M_s: float | None) -> SweepGoal:
    """What ranks and limits the rows of a sweep, where another limit of M_s may be given."""
    return result.goal if max_M_s is None else result.goal.limited({"M_s": max_M_s})
