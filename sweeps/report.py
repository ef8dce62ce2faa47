"""A sweep for people: its heat map, what robustness costs (Pareto front), which rows to take (table)."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS
from jaxmpc.status import Status
from jaxmpc.terminal import layout
from sweeps.heat import heat_map, mapped_axes
from sweeps.labels import WORST_M_S, WORST_RMS, plain_ticks
from sweeps.result import Point, Result

__all__ = ["heat_map", "mapped_axes", "pareto_figure", "table"]

FRAME = 10.0
"""The Pareto figure shows up to this times the least residual and the least M_s; farther rows are counted."""


def pareto_figure(
    result: Result,
    path: str | Path,
    baseline: Point | None = None,
    *,
    max_M_s: float = 2.0,
) -> None:
    """Draw worst-case residual against worst-case peak sensitivity, with the front that no row beats.

    Args:
        result: The sweep.
        path: The figure's file.
        baseline: A controller to compare with; the sweep's own base controller by default.
        max_M_s: Largest accepted peak sensitivity, drawn as a line [-].
    """
    baseline = baseline or result.baseline
    shown = np.isfinite(result.worst_rms) & np.isfinite(result.worst_M_s)
    front = result.pareto()
    with figure(Path(path), size=(7.0, 4.4)) as axes:
        size, alpha = (4.0, 0.35) if shown.sum() > 2000 else (9.0, 0.5)
        rms, M_s = result.worst_rms[shown], result.worst_M_s[shown]
        axes.scatter(M_s, rms, s=size, color=BASELINE, alpha=alpha, lw=0.0, rasterized=True, label="controllers")
        if len(front):
            axes.step(front.worst_M_s, front.worst_rms, where="post", color=TUNED, lw=1.2)
            axes.scatter(front.worst_M_s, front.worst_rms, s=16, color=TUNED, zorder=3, label="Pareto front")
        axes.axvline(max_M_s, color=ACCENT, lw=0.9, ls="--", label=f"$M_s$ = {max_M_s:g}")
        if baseline and np.isfinite(baseline.rms) and np.isfinite(baseline.M_s):
            text = f"baseline: {baseline.rms:.3g} N, $M_s$ {baseline.M_s:.3g}"
            axes.scatter(
                baseline.M_s, baseline.rms, s=70, facecolor="white", edgecolor=ACCENT, lw=1.6, zorder=4, label=text
            )
        best = result.best(1, max_M_s)
        if len(best):
            text = f"best with $M_s$ ≤ {max_M_s:g}: {best.worst_rms[0]:.3g} N"
            axes.scatter(
                best.worst_M_s, best.worst_rms, s=130, marker="*", color=ACCENT, edgecolor="white", zorder=5, label=text
            )
        if len(rms):
            axes.set_xscale("log")
            axes.set_yscale("log")
            plain_ticks(axes.xaxis)
            plain_ticks(axes.yaxis)
        outside = _frame(axes, M_s, rms, baseline)
        axes.set_xlabel(WORST_M_S)
        axes.set_ylabel(WORST_RMS)
        failed = int((~shown).sum())
        text = f"{len(result)} controllers on {len(result.plan.stiffness)} stiffnesses: {failed} not stable on all"
        text += f", {outside} outside the frame" if outside else ""
        axes.set_title(text, loc="left", fontsize=9.0, color=BASELINE)
        axes.legend(loc="upper right")


def _frame(axes: Any, M_s: np.ndarray, rms: np.ndarray, baseline: Point | None) -> int:
    """Keep the figure to what matters; returns how many rows are not in it."""
    if not len(rms):
        return 0
    outside = np.zeros(len(rms), bool)
    for values, limit, base in ((M_s, axes.set_xlim, "M_s"), (rms, axes.set_ylim, "rms")):
        known = getattr(baseline, base) if baseline else np.inf
        top = max(FRAME * values.min(), 1.5 * known if np.isfinite(known) else 0.0)
        if values.max() > top:
            limit(right=top) if base == "M_s" else limit(top=top)
            outside |= values > top
    return int(outside.sum())


RESIDUALS = ("rms", "true_rms")
"""As the sensor reads it, which is what ranks, and of the force itself."""


def table(result: Result, n: int = 10, max_M_s: float = 2.0) -> str:
    """The best rows as aligned text: swept parameters, worst-case residual and margins.

    Args:
        result: The sweep.
        n: Rows at most.
        max_M_s: Largest accepted worst-case peak sensitivity [-].
    """
    best = result.best(n, max_M_s)
    if not len(best):
        stable = int((result["status"] == Status.OK).all(axis=1).sum())
        return f"no row has M_s ≤ {max_M_s:g} at every stiffness; {stable} of {len(result)} are stable at every one"
    swept = [axis.name for axis in result.plan.space.axes]
    columns = [best["row"], *(best[name] for name in swept)]
    columns += [METRICS[name].times * best[name].max(axis=(1, 2)) for name in RESIDUALS]
    columns += [margin.times * margin.worst(best[name], axis=1) for name, margin in MARGINS.items()]
    shown = [*(PARAMETERS[name] for name in swept), *(METRICS[name] for name in RESIDUALS), *MARGINS.values()]
    lines = [["row", *(quantity.heading for quantity in shown)]]
    lines += [[f"{row}", *(f"{value:.4g}" for value in values)] for row, *values in zip(*columns, strict=True)]
    title = f"best rows with M_s ≤ {max_M_s:g}; RMS, M_s and margins are the worst over stiffness (and axis)"
    return f"{title}\n\n{layout.table(lines[0], lines[1:])}"
