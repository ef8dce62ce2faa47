"""Pictures of the loops before and after, one panel per tissue: sensitivity, Nyquist curve, step response."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.pictures.figures import ACCENT, figure
from jaxmpc.report.loops import Curves
from tuning.proof.result import TuneResult
from tuning.reports.figures import BOTH, logarithmic

ABREAST = 4
"""Panels side by side."""
WINDOW = (-3.0, 1.0, -2.0, 2.0)
"""What the Nyquist figure shows: left, right, bottom, top."""
SETTLED = 0.05
"""Share of a step within which it counts as settled."""


def sensitivity_figure(result: TuneResult, pair: Sequence[Curves], path: Path) -> None:
    """|S| over frequency, with the limit of M_s where that is a goal.

    Args:
        result: What `tune` returned.
        pair: Curves before and after.
        path: Where the figure goes.
    """
    limit = result.spec.goals.get("M_s")
    with _panels(result, path, 2.6) as panels:
        for i, panel in enumerate(panels):
            for which, color, label in BOTH:
                curve, stable = pair[which], _stable(result)[which, i]
                style, text = ("-", label) if stable else (":", f"{label} (unstable)")
                peak = f", peak {curve.sensitivity[i].max():.2f}" if stable else ""
                panel.plot(curve.frequency, curve.sensitivity[i], color=color, ls=style, lw=1.4, label=text + peak)
            if limit:
                panel.axhline(limit, color=ACCENT, lw=1.0, ls="--", label=f"$M_s$ ≤ {limit:g}")
            panel.set_ylim(1e-3, 10.0)
            logarithmic(panel, "x")
            logarithmic(panel, "y")
            panel.set_xlabel("frequency [Hz]")
            panel.legend(loc="lower right")
        panels[0].set_ylabel("|S|")


def nyquist_figure(result: TuneResult, pair: Sequence[Curves], path: Path) -> None:
    """Open loop near −1, with the circle of radius 1/M_s around it that must stay empty; arguments as above."""
    limit = result.spec.goals.get("M_s")
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
    with _panels(result, path, 3.0) as panels:
        for i, panel in enumerate(panels):
            panel.plot(circle.real, circle.imag, color="black", lw=0.5, ls=":")
            for which, color, label in BOTH:
                stable = _stable(result)[which, i]
                open_loop = pair[which].open_loop[i]
                text = label if stable else f"{label} (unstable)"
                panel.plot(open_loop.real, open_loop.imag, color=color, ls="-" if stable else ":", lw=1.4, label=text)
            if limit:
                inside = -1.0 + circle / limit
                panel.fill(inside.real, inside.imag, color=ACCENT, alpha=0.15, lw=0.0)
                panel.plot(inside.real, inside.imag, color=ACCENT, lw=1.0, ls="--", label=f"$M_s$ = {limit:g}")
            panel.plot(-1.0, 0.0, "+", color=ACCENT)
            panel.set_aspect("equal")
            panel.set_xlim(*WINDOW[:2])
            panel.set_ylim(*WINDOW[2:])
            panel.set_xlabel("Re L")
        panels[0].set_ylabel("Im L")
        panels[0].legend(loc="upper right")


def step_figure(result: TuneResult, pair: Sequence[Curves], path: Path) -> None:
    """Force of the linear loop after a step of its reference by 1 N; arguments as above."""
    with _panels(result, path, 2.4) as panels:
        for i, panel in enumerate(panels):
            panel.axhline(1.0, color="black", lw=0.5, ls=":")
            for which, color, label in BOTH:
                force = pair[which].force[i]
                stable = _stable(result)[which, i]
                text = f"{label}, overshoot {100 * pair[which].overshoot[i]:.0f} %" if stable else f"{label} (unstable)"
                # An unstable answer soon leaves every frame.
                shown = np.where(np.abs(force) < 20.0, force, np.nan)
                panel.plot(1e3 * pair[which].time, shown, color=color, ls="-" if stable else ":", lw=1.2, label=text)
            panel.set_xlim(0.0, 1e3 * _settled(pair, i))
            low, high = panel.get_ylim()
            panel.set_ylim(low, high + 0.35 * (high - low))
            panel.set_xlabel("time [ms]")
            panel.legend(loc="upper right")
        panels[0].set_ylabel("force [N]")


def _settled(pair: Sequence[Curves], which: int) -> float:
    """When both steps on a tissue have settled for good, and a little more; at most their length [s]."""
    time = pair[0].time
    moving = np.any([np.abs(curve.force[which] - 1.0) > SETTLED for curve in pair], axis=0)
    return float(np.clip(1.3 * time[moving].max(initial=0.0), 0.02, time[-1]))


@contextmanager
def _panels(result: TuneResult, path: Path, height: float) -> Iterator[list[Any]]:
    """A panel per tissue, titled."""
    stiffness = result.spec.experiment.stiffness
    columns = min(len(stiffness), ABREAST)
    rows = -(-len(stiffness) // columns)
    with figure(path, rows, columns, size=(max(2.9 * columns, 4.0), height * rows)) as axes:
        panels = list(np.ravel(axes))
        for panel, K_s in zip(panels, stiffness, strict=False):
            panel.set_title(f"{K_s:g} N/m")
        for panel in panels[len(stiffness) :]:
            panel.set_visible(False)
        yield panels[: len(stiffness)]


def _stable(result: TuneResult) -> np.ndarray:
    """Whether the judged loop is stable, (2, stiffness)."""
    return result.stable(result.spec.ideal)
