"""Pictures of a tuning run: the way there, and the residual on held-out scenarios."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from tuning.proof.reached import kept
from tuning.proof.result import TuneResult
from tuning.search.run import SearchHistory, Step
from tuning.search.state import FEASIBLE, SearchState

BOTH = ((0, BASELINE, "before"), (1, TUNED, "after"))
"""Index, colour and name of the two controllers."""


def history_figure(result: TuneResult | SearchHistory, path: Path, step: Step | None = None) -> None:
    """Score, worst residual, hard goals and parameters over the iterations, every start a line, the winner's in colour.

    Without a descent every point is a dot, the best of each iteration in colour.

    Args:
        result: What `tune` returned, or its search.
        path: Where the figure goes.
        step: One of its steps; None is the last.
    """
    step = step or result.steps[-1]
    state, space, descent = step.state, result.spec.space, step.spectra is None
    iterations = state.iteration
    chosen = np.full(iterations, state.leader) if descent else best_of_each_iteration(state)
    values = space.values(state.path[:iterations])
    ends = np.cumsum([axis.size for axis in space.axes])
    goals = [*result.spec.margin_goals, *step.problem.hard_goals]
    count = 2 + len(goals) + len(space.axes)
    columns = min(5, count)
    rows = -(-count // columns)
    with figure(path, rows, columns, size=(2.6 * columns, 2.4 * rows)) as axes:
        panels = iter(np.ravel(axes))
        for title, lines in (("score (less is better)", state.score), ("worst residual RMS [mN]", 1e3 * state.worst)):
            panel = next(panels)
            _lines(panel, lines[:iterations], chosen, title, descent)
            logarithmic(panel)
            panel.legend()
        for i, name in enumerate(goals):
            panel = next(panels)
            lines = np.where(np.isfinite(state.hard[:iterations, :, i]), state.hard[:iterations, :, i], np.nan)
            _lines(panel, lines, chosen, f"{name} / limit", descent)
            panel.axhline(1.0, color=ACCENT, lw=1.0, ls="--", label="limit")
            panel.set_ylim(0.0, 3.0)
            panel.legend()
        for axis, end in zip(space.axes, ends, strict=True):
            panel = next(panels)
            entries = values[:, :, end - axis.size : end]
            name = f"{axis.name}, geometric mean" if axis.length else axis.name
            title = f"{name} [{axis.unit}]"
            _lines(panel, np.exp(np.mean(np.log(entries), axis=2)), chosen, title, descent)
            if not axis.whole:
                logarithmic(panel)
        for panel in panels:
            panel.set_visible(False)


def before_after_figure(result: TuneResult, path: Path) -> None:
    """Held-out residual per stiffness and axis, before and after: bars of the median, whiskers over the scenarios.

    Scenarios that the controller before did not hold are left out.

    Args:
        result: What `tune` returned.
        path: Where the figure goes.
    """
    stiffness, counted = result.spec.experiment.stiffness, kept(result)
    places = np.arange(len(stiffness))
    with figure(path, 2, 3, size=(8.0, 5.4)) as axes:
        for row, (metric, title) in enumerate((("rms", "RMS"), ("peak_to_peak", "peak to peak"))):
            for a, panel in enumerate(axes[row]):
                for which, color, label in BOTH:
                    cells = 1e3 * getattr(result.heldout, metric)[which][counted][:, :, a]
                    middle, low, high = (_over_scenarios(f, cells) for f in (np.median, np.min, np.max))
                    at = places + 0.4 * (which - 0.5)
                    panel.bar(at, middle, 0.36, color=color, label=label)
                    spread = np.stack([middle - low, high - middle])
                    said = "every scenario" if which else None
                    panel.errorbar(
                        at, middle, spread, fmt="none", ecolor="black", elinewidth=0.8, capsize=2, label=said
                    )
                panel.set_xticks(places, [f"{K:g}" for K in stiffness])
            axes[row, 0].set_ylabel(f"residual {title} [mN]")
        for a in range(3):
            axes[0, a].set_title(f"{AXES[a]} axis")
            axes[1, a].set_xlabel("stiffness [N/m]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        axes[0, 0].figure.legend(handles, labels, loc="outside upper right", ncols=3)


def best_of_each_iteration(state: SearchState) -> np.ndarray:
    """The start with the best score of each iteration, among those that hold the hard goals if there are any."""
    score = np.nan_to_num(state.score[: state.iteration], nan=np.inf)
    held = state.hard[: state.iteration].max(axis=2, initial=0.0) <= FEASIBLE
    best: np.ndarray = np.lexsort((score, ~held), axis=1)[:, 0]
    return best


def logarithmic(panel: Any, which: str = "y") -> None:
    """A logarithmic axis, with numbers as people write them where it spans less than two decades.

    Args:
        panel: With its data drawn.
        which: "x" or "y".
    """
    from matplotlib.ticker import FuncFormatter, LogLocator

    getattr(panel, f"set_{which}scale")("log")
    low, high = getattr(panel, f"get_{which}lim")()
    axis = getattr(panel, f"{which}axis")
    if high < 100.0 * low:
        fine = high < 3.0 * low
        axis.set_major_locator(LogLocator(subs=range(1, 10) if fine else (1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    # Marks without numbers take most of the time that a picture takes.
    panel.minorticks_off()


def _over_scenarios(function: Any, cells: np.ndarray) -> np.ndarray:
    """Per tissue, of the runs that were not lost; 0, no bar, where all were."""
    found = [column[np.isfinite(column)] for column in cells.T]
    return np.array([function(column) if len(column) else 0.0 for column in found])


def _lines(panel: Any, columns: np.ndarray, chosen: np.ndarray, title: str, joined: bool) -> None:
    from matplotlib.ticker import MaxNLocator

    marks = {"ls": "-" if joined else "", "marker": "" if joined else "."}
    best = columns[np.arange(len(columns)), chosen]
    panel.plot(columns, color=BASELINE, lw=0.6, alpha=0.6, ms=4.0, **marks)
    panel.plot(best, color=TUNED, lw=1.6, ms=7.0, label="winner" if joined else "best", **marks)
    panel.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    panel.set_title(title)
    panel.set_xlabel("iteration")
