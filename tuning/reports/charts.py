"""Charts of a tuning run: the way there, held-out residuals, loops, causes, sensitivities."""

from collections.abc import Iterator

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.report.charts import LoopCurve, loop_charts
from jaxmpc.report.content import Chart, Mark, Series
from jaxmpc.report.loops import Curves
from tuning.proof.reached import kept
from tuning.proof.result import TuneResult
from tuning.proof.sensitivities import Sensitivities
from tuning.proof.split import CAUSES, Split
from tuning.reports.figures import best_of_each_iteration
from tuning.search.run import Step

BEFORE, AFTER, OTHERS = 1, 0, 7
"""Colours: the controller before, the tuned one, starts that did not win."""
BOTH = ((0, BEFORE, "before"), (1, AFTER, "after"))
"""Index, colour and name of the two controllers."""
BESIDE = 0.2
"""Where a bar stands beside the middle of its tissue, in distances between tissues."""
MOST_LINES = 12
"""Starts that are drawn beside the winner."""


def history_charts(result: TuneResult, step: Step) -> list[Chart]:
    """Score, worst residual, hard goals and parameters over the iterations, the winner in colour.

    Args:
        result: What `tune` returned.
        step: One of its steps.
    """
    state, space = step.state, result.spec.space
    iterations = state.iteration
    values = space.values(state.path[:iterations])
    ends = np.cumsum([axis.size for axis in space.axes])
    charts = [
        _over_iterations(step, state.score[:iterations], "score", "-", log=True),
        _over_iterations(step, 1e3 * state.worst[:iterations], "worst residual RMS", "mN", log=True),
    ]
    for i, name in enumerate([*result.spec.margin_goals, *step.problem.hard_goals]):
        lines = state.hard[:iterations, :, i]
        charts.append(_over_iterations(step, lines, f"{name} / limit", "-", marks=[Mark("limit", y=1.0)]))
    for axis, end in zip(space.axes, ends, strict=True):
        entries = values[:, :, end - axis.size : end]
        name = f"{axis.name}, geometric mean" if axis.length else axis.name
        lines = np.exp(np.mean(np.log(entries), axis=2))
        charts.append(_over_iterations(step, lines, name, axis.unit, log=not axis.whole))
    return charts


def _over_iterations(
    step: Step, lines: np.ndarray, title: str, unit: str, log: bool = False, marks: list[Mark] | None = None
) -> Chart:
    """One number of every start over the iterations; without a descent a point is a dot."""
    descent = step.spectra is None
    iterations = np.arange(len(lines))
    chosen = np.full(len(lines), step.state.leader) if descent else best_of_each_iteration(step.state)
    best = lines[iterations, chosen]
    shown = np.where(np.isfinite(lines), lines, np.nan)
    others = [Series("", iterations, shown[:, k], OTHERS, "line" if descent else "dots") for k in _others(step, lines)]
    winner = Series("winner" if descent else "best", iterations, best, AFTER, "line" if descent else "dots")
    return Chart(title, "iteration", f"{title} [{unit}]", [*others, winner], marks or (), y_log=log)


def _others(step: Step, lines: np.ndarray) -> list[int]:
    starts = [k for k in range(lines.shape[1]) if k != step.state.leader]
    return starts[:MOST_LINES]


def heldout_charts(result: TuneResult) -> list[Chart]:
    """Held-out residual per tissue and axis, before and after: bars of the median, dots of every scenario.

    Scenarios that the controller before did not hold are left out.
    """
    stiffness, counted = result.spec.experiment.stiffness, kept(result)
    places = [f"{K_s:g} N/m" for K_s in stiffness]
    charts = []
    for metric, title in (("rms", "RMS"), ("peak_to_peak", "peak to peak")):
        for a, axis in enumerate(AXES):
            series = []
            for which, color, label in BOTH:
                cells = 1e3 * np.asarray(getattr(result.heldout, metric))[which][counted][:, :, a]
                series.append(Series(label, [], [_median(column) for column in cells.T], color, "bars"))
                at = np.repeat(np.arange(len(stiffness)) + BESIDE * (2 * which - 1), len(cells))
                series.append(Series(f"{label}, each scenario", at, cells.T.ravel(), color, "dots"))
            charts.append(Chart(f"{title}, {axis}", "", f"residual {title} [mN]", series, categories=places))
    return charts


def _median(column: np.ndarray) -> float:
    """Over the runs that were not lost; NaN where all were."""
    finite = column[np.isfinite(column)]
    return float(np.median(finite)) if len(finite) else float("nan")


def loops(result: TuneResult, pair: tuple[Curves, Curves]) -> list[Chart]:
    """|S|, Nyquist, Bode and step on every tissue, before and after."""
    stable, limit = result.stable(result.spec.ideal), result.spec.goals.get("M_s")
    charts = []
    for i, K_s in enumerate(result.spec.experiment.stiffness):
        both = [LoopCurve(name, pair[which], i, color, bool(stable[which, i])) for which, color, name in BOTH]
        charts += loop_charts(f"{K_s:g} N/m", both, limit)
    return charts


def split_charts(result: TuneResult, parts: Split) -> list[Chart]:
    """What each cause alone would leave of the residual on every axis, before beside after."""
    places = [f"{K_s:g} N/m" for K_s in result.spec.experiment.stiffness]
    shown = [name for name in ("whole", *CAUSES) if np.nanmax(getattr(parts, name), initial=0.0) > 0.0]
    return [
        Chart(
            f"{axis} axis",
            "",
            "residual RMS [mN]",
            [
                Series(f"{_cause(name)}, {label}", [], 1e3 * getattr(parts, name)[which, :, a], 2 * k + which, "bars")
                for k, name in enumerate(shown)
                for which, _, label in BOTH
            ],
            categories=places,
        )
        for a, axis in enumerate(AXES)
    ]


def _cause(name: str) -> str:
    return "all together" if name == "whole" else name


def sensitivity_charts(result: TuneResult, found: Sensitivities) -> Iterator[Chart]:
    """Per metric the exact slopes d log metric / d log parameter, a bar per tissue."""
    for k, metric in enumerate(found.metrics):
        series = [
            Series(f"{K_s:g} N/m", [], found.slopes[k, :, i], i, "bars")
            for i, K_s in enumerate(result.spec.experiment.stiffness)
        ]
        yield Chart(metric, "", "change [% per %]", series, categories=found.parameters)
