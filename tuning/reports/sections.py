"""What a report of a tuning run says, as titles, sentences and tables; `text` and `page` only say how it looks."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS, Metric
from jaxmpc.report.content import Section, Table
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.structure import STRUCTURE
from tuning.job.space import KNOTS
from tuning.proof.found import KINDS
from tuning.proof.limits import active_margins
from tuning.proof.reached import kept, rows, verdict
from tuning.proof.result import TuneResult
from tuning.search.state import FEASIBLE

AT_BOUND = 0.01
"""A parameter nearer to a bound, as a share of its room, rests there: it has a 25th of its slope in the middle [-]."""


def summary(result: TuneResult) -> tuple[str, str]:
    """How it stands to its goals, and what became of the worst residual."""
    words = []
    for name in ("rms", "true_rms"):
        metric, (before, after) = METRICS[name], result.worst_of(name)
        change = f" ({100 * (after / before - 1.0):+.1f} %)" if np.isfinite(after / before) else ""
        words.append(f"{metric.heading}: {_entry(metric, before)} → {_entry(metric, after)}{change}")
    return verdict(result), f"worst held-out {', '.join(words)}"


def sections(result: TuneResult) -> list[Section]:
    """What a report says of the result itself."""
    return [_heldout(result), _goals(result), _parameters(result), _scenarios(result), _robustness(result)]


def way(result: TuneResult) -> Iterator[str]:
    """A sentence for each step of the search."""
    for step in result.steps:
        state = step.state
        skipped = f", {int(state.skipped.sum())} steps skipped for a gradient not finite" if state.skipped.any() else ""
        score = f"{state.best.min():.4f}" if state.feasible else "no feasible point"
        yield f"{step.name}: {state.iteration} iterations of {len(state.z)} starts, score {score}{skipped}"


def at_bounds(result: TuneResult) -> Iterator[str]:
    """Which parameters of the tuned controller rest at which bound, in words without an end."""
    for axis in result.spec.space.axes:
        share = np.ravel(axis.share(axis.of(result.params)))
        for bound, rests in ((axis.low, share < AT_BOUND), (axis.high, share > 1.0 - AT_BOUND)):
            if rests.any():
                yield f"{axis.name} rests at its bound of {bound:g} {axis.unit}".removesuffix(" -")


def _heldout(result: TuneResult) -> Section:
    seeds, stiffness, counted = result.spec.tune.heldout_seeds, result.spec.experiment.stiffness, kept(result)
    tables = []
    for metric in METRICS.values():
        if metric.arm_only and not result.spec.on_arm:
            continue
        cells, fell = getattr(result.heldout, metric.name), _lowered(result, metric)
        worst = cells[:, counted].max(axis=1)
        lines, each = [], []
        for i, K_s in enumerate(stiffness):
            changes = zip(_arrows(metric, worst[:, i]), map(_percent, fell[i]), strict=True)
            lines.append([f"{K_s:g}", *(entry for pair in changes for entry in pair)])
            each += [[f"{seed}, {K_s:g} N/m", *_arrows(metric, cells[:, s, i])] for s, seed in enumerate(seeds)]
        head = [entry for axis in AXES for entry in (f"{axis}, worst", "over all")]
        tables.append(Table([f"{metric.heading} at K_s [N/m]", *head], lines))
        tables.append(Table(["seed, K_s", *AXES], each, f"{metric.heading} in every scenario: {metric.text}"))
    return Section("Residual on held-out scenarios", [] if result.held.all() else [_lost(result)], tables)


def _goals(result: TuneResult) -> Section:
    spec = result.spec
    lines = []
    for row in rows(result):
        place = f"{row.at:.4g}" if row.at else ""
        lines.append([f"{row.kind}: {row.text}", *(f"{value:.4g}" for value in row.reached), row.said, place])
    kind, seen = "the ideal loop" if spec.ideal else "the loop as it runs", len(spec.tune.train_seeds)
    words = (
        f"Margins are those of {kind}, the worst over all tissues; goals of the runs are the worst of the held-out "
        "scenarios, ratios of those that the controller before held. Hard goals are held, soft ones minimised: "
        f"{spec.risk.kind} over {seen} scenario{'s' * (seen != 1)} in training."
    )
    if spec.implied:
        words += " Implied ones are not in the job: freezing for a robot demands them."
    return Section("Goals", [words], [Table(("goal", "before", "after", "met", "worst at K_s [N/m]"), lines)])


def _parameters(result: TuneResult) -> Section:
    spec, both = result.spec, (result.spec.before, result.params)
    bounds = {axis.name: f"{axis.low:g} … {axis.high:g}" for axis in spec.space.axes}
    lines, tables = [], []
    sentences = [f"{resting}." for resting in at_bounds(result)]
    for name, row in PARAMETERS.items():
        values: list[Any] = [params.numbers.get(name) for params in both]
        lines.append([name, *map(_brief, values), row.unit, bounds.get(name, "frozen")])
        if any(np.ndim(value) for value in values):
            entries = np.broadcast_arrays(*values)
            each = [[str(k + 1), *(f"{x:.4g}" for x in pair)] for k, pair in enumerate(zip(*entries, strict=True))]
            tables.append(Table(("entry", "before", "after"), each, f"every entry of {name}"))
    lines += [[name, *(str(params.structure[name]) for params in both), "", ""] for name in STRUCTURE[:-1]]
    if result.params.listening is not None:
        tables.append(_knots(result.params, bounds))
    if len(result.orders) > 1:
        scores = ", ".join(f"{order} {score:.4g}" for order, score in result.orders.items())
        sentences.append(f"Best score of each disturbance order after its descent: {scores}.")
    return Section("Parameters", sentences, [Table(("parameter", "before", "after", "unit", "bounds"), lines), *tables])


def _knots(params: Params, bounds: Mapping[str, str]) -> Table:
    """Parameters of the knots after tuning; those before may stand elsewhere, or be none."""
    assert params.listening is not None
    lines = []
    for name in params.knots[0].numbers:
        values = [_brief(getattr(knot, name)) for knot in params.knots]
        free = {text for axis, text in bounds.items() if axis.startswith(KNOTS) and axis.endswith(f".{name}")}
        lines.append([name, *values, PARAMETERS[name].unit, "; ".join(sorted(free)) or "frozen"])
    return Table(("of the knot at", *(f"{K:g} N/m" for K in params.listening.stiffness), "unit", "bounds"), lines)


def _scenarios(result: TuneResult) -> Section:
    tune = result.spec.tune
    used = {"training": tune.train_seeds, "validation": tune.validation_seeds, "held out": tune.heldout_seeds}
    lines = [[what, _spans(seeds)] for what, seeds in used.items()]
    words = []
    if "own" in result.spec.scenarios.rhythms and not result.spec.experiment.draws_motion:
        words = [
            "The experiment's own motion is one, the same held out as in training, which saw its first "
            f"{tune.duration:g} s: seeds draw all but the motion."
        ]
    return Section("Scenarios", words, [Table(("used for", "seeds"), lines)])


def _robustness(result: TuneResult) -> Section:
    at = result.spec.judged_at
    sentences = [f"Worst margins of {len(at)} tissues, {at[0]:g}–{at[-1]:g} N/m, after (before)."]
    for goal in active_margins(result):
        stands = "active" if goal.normalised <= FEASIBLE else "missed"
        sentences.append(f"{goal.goal} is {stands} at {goal.place}, {100 * goal.normalised:.1f} % of its limit.")
    lines = []
    for which, family in zip(("before", "after"), result.known, strict=True):
        if family is not None:
            values = (row.entry(row.worst(np.asarray(getattr(family.margins, name)))) for name, row in MARGINS.items())
            lines.append([f"stiffness known, {which}", *values])
    for kind in KINDS:
        found = result.margins[kind]
        pairs = ([*map(row.entry, row.worst(getattr(found, name), axis=1))] for name, row in MARGINS.items())
        lines.append([kind, *(f"{after} ({before})" for before, after in pairs)])
    return Section("Robustness", sentences, [Table(("loop", *(row.heading for row in MARGINS.values())), lines)])


def _lost(result: TuneResult) -> str:
    """Which held-out scenarios were lost."""
    seeds = np.asarray(result.spec.tune.heldout_seeds)
    before, after = (", ".join(map(str, seeds[~held])) or "none" for held in result.held)
    treated = "left out below" if result.held[0].any() else "all of them, so none is left out"
    return f"Lost before: {before}{f' ({treated})' if before != 'none' else ''}; lost after: {after}."


def _lowered(result: TuneResult, metric: Metric) -> np.ndarray:
    """`TuneResult.lowered`, or NaN where the controller before held no scenario."""
    if result.held[0].any():
        return result.lowered(metric.name)
    return np.full((len(result.spec.experiment.stiffness), 3), np.nan)


def _arrows(metric: Metric, pair: np.ndarray) -> list[str]:
    """Values before and after, (2, 3), as text per axis."""
    return [f"{_entry(metric, before)} → {_entry(metric, after)}" for before, after in pair.T]


def _entry(metric: Metric, value: float) -> str:
    return metric.entry(value) if np.isfinite(value) else "unstable"


def _percent(share: float) -> str:
    """How far something fell, as a change."""
    # Without a zero that is negative.
    return f"{round(-100.0 * share, 1) + 0.0:+.1f} %" if np.isfinite(share) else "–"


def _brief(value: Any) -> str:
    """A value, or the range of a diagonal; None is a filter of the experiment's."""
    if value is None:
        return "the experiment's"
    return f"{value:.4g}" if np.ndim(value) == 0 else f"{np.min(value):.2g}…{np.max(value):.2g}"


def _spans(seeds: Sequence[int]) -> str:
    """Seeds, those in a row as a span."""
    found: list[list[int]] = []
    for seed in sorted(seeds):
        if found and seed == found[-1][-1] + 1:
            found[-1].append(seed)
        else:
            found.append([seed])
    spans = (f"{span[0]}–{span[-1]}" if len(span) > 2 else ", ".join(map(str, span)) for span in found)
    return ", ".join(spans) or "none"
