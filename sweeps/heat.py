"""The heat map of a sweep: where in the plane of its two most influential parameters it is good."""

from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.pictures.figures import ACCENT, BASELINE, figure
from jaxmpc.quantities import HORIZONS, PARAMETERS
from sweeps.axis import SweepAxis
from sweeps.labels import WORST_RMS, plain_ticks
from sweeps.result import Result

MOST_BINS, ROWS_A_BIN = 24, 12
"""Bins of a random sweep along one axis of the heat map, and rows aimed at in each cell."""
SPREAD = 3.0
"""Ratio of largest to smallest from which colours are logarithmic."""


class _Bins:
    """A swept axis cut into cells: its grid points, its listed values, or stretches of its range."""

    def __init__(self, axis: SweepAxis, values: np.ndarray, sampled: bool, bins: int) -> None:
        self.axis = axis
        self.log = axis.scale == "log"
        if sampled and axis.scale != "list":
            low, high = axis.values
            self.edges: np.ndarray = (np.geomspace if self.log else np.linspace)(low, high, bins + 1)
            self.cell = np.clip(np.searchsorted(self.edges, values, "right") - 1, 0, bins - 1)
            self.ticks: list[str] | None = None
            return
        points = np.unique(axis.values)
        self.cell = np.searchsorted(points, values)
        if axis.scale == "list" or len(points) == 1:
            self.log, self.edges, self.ticks = False, np.arange(len(points) + 1) - 0.5, [f"{p:g}" for p in points]
            return
        inner = np.sqrt(points[1:] * points[:-1]) if self.log else (points[1:] + points[:-1]) / 2.0
        first = points[0] ** 2 / inner[0] if self.log else 2.0 * points[0] - inner[0]
        last = points[-1] ** 2 / inner[-1] if self.log else 2.0 * points[-1] - inner[-1]
        self.edges, self.ticks = np.concatenate([[first], inner, [last]]), None

    @property
    def count(self) -> int:
        return len(self.edges) - 1

    @property
    def centres(self) -> np.ndarray:
        low, high = self.edges[:-1], self.edges[1:]
        centres: np.ndarray = np.sqrt(low * high) if self.log else (low + high) / 2.0
        return centres

    def place(self, value: float) -> float | None:
        """Where a value lies along the axis of the figure; None if it is off it."""
        if self.ticks is not None:
            found = np.flatnonzero(np.isclose(np.unique(self.axis.values), value))
            return float(found[0]) if len(found) else None
        return value if self.edges[0] <= value <= self.edges[-1] else None


def influence(result: Result) -> dict[str, float]:
    """Share of the variance of log worst-case residual that each swept parameter explains alone.

    Rows that are not OK everywhere count as twice the worst of the others.
    """
    finite = np.isfinite(result.worst_rms)
    if not finite.any():
        return {axis.name: 0.0 for axis in result.plan.space.axes}
    score = np.log(np.where(finite, result.worst_rms, 2.0 * result.worst_rms[finite].max()))
    shares = {}
    for axis in result.plan.space.axes:
        cell = _Bins(axis, result[axis.name], result.plan.space.kind == "random", MOST_BINS // 2).cell
        size = np.bincount(cell)
        means = np.bincount(cell, score) / np.maximum(size, 1)
        shares[axis.name] = float((size * (means - score.mean()) ** 2).sum() / max(len(score) * score.var(), 1e-30))
    return shares


def mapped_axes(result: Result) -> tuple[str, str] | None:
    """The two most influential swept parameters, in the order of the spec; None where there are not two."""
    shares = influence(result)
    varied = [axis.name for axis in result.plan.space.axes if len(axis.values) > 1]
    if len(varied) < 2:
        return None
    first, second = sorted(sorted(varied, key=lambda name: -shares[name])[:2], key=varied.index)
    return first, second


def heat_map(
    result: Result,
    path: str | Path,
    x: str | None = None,
    y: str | None = None,
    *,
    max_M_s: float = 2.0,
) -> None:
    """Draw the least worst-case residual in each cell of two parameters, over everything else that is swept.

    Cells take their best row with M_s ≤ max_M_s; without one they are hatched and show their best stable
    row; without any stable row they are grey.

    Args:
        result: The sweep.
        path: The figure's file.
        x: Parameter across; the most influential ones by default.
        y: Parameter upwards.
        max_M_s: Largest accepted worst-case peak sensitivity [-].

    Raises:
        InputError: x or y is not swept, or fewer than two parameters are.
    """
    swept = {axis.name: axis for axis in result.plan.space.axes}
    for name in (x, y):
        if name is not None and name not in swept:
            raise InputError("axis of the heat map", name, "a swept parameter", nearest(name, list(swept)))
    pair = mapped_axes(result)
    if pair is None or (x is not None and x == y):
        raise InputError("heat map", ", ".join(swept), "of two swept parameters", "Sweep another, or name two.")
    free = [name for name in (*pair, *swept) if name not in (x, y)]
    x = x or free.pop(0)
    y = y or free[0]
    random = result.plan.space.kind == "random"
    bins = int(np.clip(np.sqrt(len(result) / ROWS_A_BIN), 2, MOST_BINS))
    across, up = (_Bins(swept[name], result[name], random, bins) for name in (x, y))
    shape = (up.count, across.count)
    rms, robust = result.worst_rms, result.worst_M_s <= max_M_s
    best = _least(shape, up.cell, across.cell, np.where(robust, rms, np.inf))
    fragile = _least(shape, up.cell, across.cell, rms)
    visited = np.zeros(shape, bool)
    visited[up.cell, across.cell] = True
    shown = np.where(np.isfinite(best), best, fragile)
    hatched = ~np.isfinite(best) & np.isfinite(fragile)

    with figure(Path(path), size=(7.0, 4.8)) as axes:
        (colours, beyond), drawing = _colours(shown[np.isfinite(shown)]), axes.figure
        axes.grid(visible=False)
        failed = visited & ~np.isfinite(shown)
        axes.pcolormesh(across.edges, up.edges, np.where(failed, 1.0, np.nan), cmap="Greys", vmin=0.0, vmax=3.0)
        mesh = axes.pcolormesh(
            across.edges, up.edges, np.where(np.isfinite(shown), shown, np.nan), cmap="viridis", norm=colours
        )
        # One hatched patch per cell keeps to the cell; contours would round the corners.
        _hatch(axes, across.edges, up.edges, hatched)
        bar = drawing.colorbar(mesh, ax=axes, pad=0.02, extend="max" if beyond else "neither")
        bar.set_label(WORST_RMS)
        bar.outline.set_visible(False)
        if bar.ax.get_yscale() == "log":
            plain_ticks(bar.ax.yaxis)
        _dress(axes, "x", across, x)
        _dress(axes, "y", up, y)
        if random or len(swept) > 2:
            axes.set_title("best of each cell over everything else swept", loc="left", fontsize=9.0, color=BASELINE)
        marks = _mark(axes, result, across, up, max_M_s)
        legend = [*marks, *_patches(bool(hatched.any()), bool(failed.any()), max_M_s)]
        if legend:
            drawing.legend(handles=legend, loc="outside lower center", ncols=len(legend))


def _least(shape: tuple[int, int], up: np.ndarray, across: np.ndarray, values: np.ndarray) -> np.ndarray:
    least = np.full(shape, np.inf)
    np.minimum.at(least, (up, across), values)
    return least


def _colours(values: np.ndarray) -> tuple[Any, bool]:
    """A colour scale, logarithmic where the values span much, and whether the worst of them lie beyond it."""
    from matplotlib.colors import LogNorm, Normalize

    if not len(values):
        return Normalize(0.0, 1.0), False
    low, high = float(values.min()), float(np.quantile(values, 0.95))
    scale = LogNorm if 0.0 < SPREAD * low < high else Normalize
    return scale(low, max(high, 1.001 * low)), bool(values.max() > high)


def _hatch(axes: Any, x: np.ndarray, y: np.ndarray, cells: np.ndarray) -> None:
    from matplotlib.patches import Rectangle

    for j, i in np.argwhere(cells):
        size = x[i + 1] - x[i], y[j + 1] - y[j]
        axes.add_patch(Rectangle((x[i], y[j]), *size, fill=False, hatch="///", edgecolor=(1, 1, 1, 0.35), lw=0.0))


def _dress(axes: Any, letter: Literal["x", "y"], bins: _Bins, name: str) -> None:
    """Label, scale and ticks of one axis of the heat map."""
    which = getattr(axes, f"{letter}axis")
    which.set_label_text(PARAMETERS[name].label)
    if bins.log:
        axes.set(**{f"{letter}scale": "log"})
    if bins.ticks is not None:
        every = -(-len(bins.ticks) // 16)
        which.set_ticks(np.arange(len(bins.ticks))[::every], bins.ticks[::every])
    elif name in HORIZONS:
        which.get_major_locator().set_params(integer=True)


def _mark(axes: Any, result: Result, across: _Bins, up: _Bins, limit: float) -> list[Any]:
    """The best row and the base controller, where they lie."""
    marks = []
    best = result.best(1, limit)
    if len(best):
        place = [bins.place(float(best[bins.axis.name][0])) for bins in (across, up)]
        label = f"best with $M_s$ ≤ {limit:g}: {best.worst_rms[0]:.3g} N"
        marks.append(axes.scatter(*place, s=110, marker="*", color=ACCENT, edgecolor="white", zorder=4, label=label))
    base = [bins.place(float(np.mean(getattr(result.plan.base, bins.axis.name)))) for bins in (across, up)]
    if None not in base:
        marks.append(
            axes.scatter(
                *base, s=55, marker="o", facecolor="none", edgecolor=ACCENT, lw=1.6, zorder=4, label="baseline"
            )
        )
    return marks


def _patches(fragile: bool, failed: bool, limit: float) -> list[Any]:
    from matplotlib.patches import Patch

    hatched = Patch(facecolor=BASELINE, hatch="////", edgecolor="white", lw=0.0, label=f"$M_s$ > {limit:g}")
    grey = Patch(facecolor="#d0d0d0", label="unstable")
    return [patch for patch, wanted in ((hatched, fragile), (grey, failed)) if wanted]
