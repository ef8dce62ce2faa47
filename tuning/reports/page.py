"""The report of a tuning run as one page: what was reached, how robust it is, why it is as it is, the way there."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from jaxmpc import __version__
from jaxmpc.experiment import AXES
from jaxmpc.quantities import METRICS, PARAMETERS, Metric
from jaxmpc.synthesis.params import STRUCTURE
from tuning.job.scenarios import describe
from tuning.proof.loops import Curves
from tuning.proof.reached import Row, kept, rows, verdict
from tuning.proof.result import KINDS, TuneResult
from tuning.reports.explained import Study, explained
from tuning.reports.figures import before_after_figure, history_figure
from tuning.reports.html import Html, fold, note, page, picture, section, table, tag
from tuning.reports.loop_figures import nyquist_figure, sensitivity_figure, step_figure
from tuning.reports.text import (
    brief,
    lost_text,
    lowered,
    margin_heads,
    percent,
    seeds_used,
    shown,
    worst_margins,
)


def html_report(result: TuneResult, study: Study) -> str:
    """The page; it needs no network and no other file.

    Args:
        result: What `tune` returned.
        study: What explains it.
    """
    spec, (before, after) = result.spec, result.worst
    rms, unmet = METRICS["rms"], result.unmet()
    change = f" ({-100 * result.gain:+.1f} %)" if np.isfinite(result.gain) else ""
    title = f"Tuning report: {spec.experiment.name}"
    histories = (
        fold(step.name, picture(partial(history_figure, result, step=step)), opened=step is result.steps[-1])
        for step in result.steps
    )
    return page(
        title,
        tag("h1", title),
        tag("p", verdict(result) + ".", class_="bad" if unmet else "good"),
        tag("p", f"Worst held-out residual RMS: {shown(rms, before)} → {shown(rms, after)} mN{change}."),
        _heldout(result),
        section("Goals", table(GOAL_HEAD, map(_goal, rows(result))), note(_goal_note(result))),
        _parameters(result),
        section("Scenarios", table(("used for", "seeds"), seeds_used(result)), *_added(result)),
        _robustness(result, study.loops),
        *explained(result, study),
        section("The way there", note("Every start is a line, the winner's in colour."), *histories),
        note(f"jaxmpc {__version__}, job {spec.digest[:12]}."),
    )


GOAL_HEAD = ("goal", "limit", "before", "after", "worst at K_s [N/m]", "met")


def _goal(row: Row) -> list[Any]:
    verdict = tag("span", "yes" if row.met else "no", class_="good" if row.met else "bad")
    values = (f"{value:.4g}" for value in row.reached)
    return [row.kind, row.text, *values, f"{row.at:.4g}" if row.at else "", verdict]


def _goal_note(result: TuneResult) -> str:
    kind = "the ideal loop" if result.spec.ideal else "the loop as it runs"
    return (
        f"Margins are those of {kind}, the worst over all tissues; goals of the runs are the worst of the held-out "
        "scenarios. Hard goals are held, soft ones minimised."
    )


def _heldout(result: TuneResult) -> Html:
    seeds, stiffness, counted = result.spec.tune.heldout_seeds, result.spec.experiment.stiffness, kept(result)
    tables = []
    for metric in METRICS.values():
        cells, fell = getattr(result.heldout, metric.name), lowered(result, metric.name)
        worst = cells[:, counted].max(axis=1)
        lines, each = [], []
        for i, K_s in enumerate(stiffness):
            changes = zip(_arrows(metric, worst[:, i]), map(percent, fell[i]), strict=True)
            lines.append([f"{K_s:g}", *(entry for pair in changes for entry in pair)])
            each += [[f"{seed}, {K_s:g} N/m", *_arrows(metric, cells[:, s, i])] for s, seed in enumerate(seeds)]
        head = [entry for axis in AXES for entry in (f"{axis}, worst", "over all")]
        tables.append(table([f"{metric.heading} at K_s [N/m]", *head], lines))
        tables.append(fold(f"{metric.heading} in every scenario: {metric.text}", table(["seed, K_s", *AXES], each)))
    figure = picture(partial(before_after_figure, result))
    words = "Bars are medians, whiskers ranges; the pointer resting on a bar shows each scenario. "
    lost = "" if result.held.all() else lost_text(result).capitalize() + "."
    return section("Residual on held-out scenarios", figure, note(words, lost), *tables)


def _arrows(metric: Metric, pair: np.ndarray) -> list[str]:
    """Values before and after, (2, 3), as text per axis."""
    return [f"{shown(metric, before)} → {shown(metric, after)}" for before, after in pair.T]


def _parameters(result: TuneResult) -> Html:
    spec, both = result.spec, (result.spec.before, result.params)
    bounds = {axis.name: f"{axis.low:g} … {axis.high:g}" for axis in spec.space.axes}
    lines, folds = [], []
    for name, row in PARAMETERS.items():
        values = [np.asarray(getattr(params, name)) for params in both]
        lines.append([name, *map(brief, values), row.unit, bounds.get(name, "frozen")])
        if any(value.ndim for value in values):
            entries = (", ".join(f"{x:.4g}" for x in value.ravel()) for value in values)
            lists = (tag("p", f"{when}: {entry}") for when, entry in zip(("before", "after"), entries, strict=True))
            folds.append(fold(f"every entry of {name}", *lists))
    lines += [[name, *(params.structure[name] for params in both), "", ""] for name in STRUCTURE]
    if len(result.orders) > 1:
        scores = ", ".join(f"{order} {score:.4g}" for order, score in result.orders.items())
        folds.append(note(f"Best score of each disturbance order on the first level: {scores}."))
    return section("Parameters", table(("parameter", "before", "after", "unit", "bounds"), lines), *folds)


def _added(result: TuneResult) -> Iterator[Html]:
    """What the worst-case search has added."""
    for step in result.steps:
        if step.added:
            found = f"{describe(step.added.trained)}; soft goal {step.added.value:.3g}, {step.added.known:.3g} known"
            yield note(f"{step.name}: {found}.")


def _robustness(result: TuneResult, loops: tuple[Curves, Curves]) -> Html:
    spec = result.spec
    pairs = {kind: worst_margins(result, kind) for kind in KINDS}
    lines = [[kind, *(f"{after} ({before})" for before, after in each)] for kind, each in pairs.items()]
    cut = "" if spec.ideal else " Of its two cuts, at v and at a = v − K₂ẋ, the worse is shown."
    kind = "ideal loop" if spec.ideal else "loop as it runs"
    return section(
        "Robustness",
        note(f"Worst margins over {spec.judged_at[0]:g}–{spec.judged_at[-1]:g} N/m, after (before)."),
        table(("loop", *margin_heads()), lines),
        picture(partial(sensitivity_figure, result, loops)),
        note(f"Sensitivity |S| = |1/(1 + L)| of the {kind}.{cut}"),
        picture(partial(nyquist_figure, result, loops)),
        note("Open loop L from 0.1 Hz up. It must stay out of the disc around −1, whose radius is 1/M_s."),
        picture(partial(step_figure, result, loops)),
        note("Force of the linear loop, without the arm, after a step of its reference by 1 N."),
    )
