"""A tuning run as plain text: parameters, the table before and after, and how it stands to its goals."""

from collections.abc import Iterator

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS, Metric
from tuning.job.scenarios import describe
from tuning.proof.limits import active_margins
from tuning.proof.reached import kept, rows, verdict
from tuning.proof.result import KINDS, TuneResult
from tuning.search.state import FEASIBLE


def report(result: TuneResult) -> str:
    """The whole result as plain text."""
    spec, (before, after) = result.spec, result.worst
    change = f" ({-100 * result.gain:+.1f} %)" if np.isfinite(result.gain) else ""
    lines = [verdict(result), "", *_goals(result), "", *_parameters(result), ""]
    lines += [f"{name}: {seeds}" for name, seeds in seeds_used(result)]
    lines += [lost_text(result)] if not result.held.all() else []
    for metric in METRICS.values():
        lines += ["", *_heldout(result, metric)]
    lines.append(f"worst RMS of all: {shown(METRICS['rms'], before)} → {shown(METRICS['rms'], after)} mN{change}")
    lines += ["", f"worst margins over {spec.judged_at[0]:g}–{spec.judged_at[-1]:g} N/m, after (before)"]
    lines.append(f"{'loop':<8}" + "".join(f"{name:>18}" for name in margin_heads()))
    for kind in KINDS:
        pairs = worst_margins(result, kind)
        lines.append(f"{kind:<8}" + "".join(f"{f'{after} ({before})':>18}" for before, after in pairs))
    for name, K_s, normalised in active_margins(result):
        stands = "active" if normalised <= FEASIBLE else "missed"
        lines.append(f"{name} is {stands} at {K_s:.4g} N/m, {100 * normalised:.1f} % of its limit")
    lines.append("")
    for step in result.steps:
        state = step.state
        skipped = f", {int(state.skipped.sum())} steps skipped for a gradient not finite" if state.skipped.any() else ""
        added = f"; added {describe(step.added.trained)}" if step.added else ""
        score = f"{state.best.min():.4f}" if state.feasible else "no feasible point"
        lines.append(
            f"{step.name}: {state.iteration} iterations of {len(state.z)} starts, score {score}{skipped}{added}"
        )
    return "\n".join(lines) + "\n"


def seeds_used(result: TuneResult) -> list[tuple[str, str]]:
    """Which scenarios served for what."""
    tune = result.spec.tune
    added = [str(step.added.trained.motion.seed) for step in result.steps if step.added]
    return [
        ("training", _spans(tune.train_seeds)),
        ("added by the worst-case search", ", ".join(added) or "none"),
        ("validation", _spans(tune.validation_seeds)),
        ("held out", _spans(tune.heldout_seeds)),
    ]


def lost_text(result: TuneResult) -> str:
    """Which held-out scenarios were lost, in a sentence."""
    seeds = np.asarray(result.spec.tune.heldout_seeds)
    before, after = (", ".join(map(str, seeds[~held])) or "none" for held in result.held)
    treated = "left out below" if result.held[0].any() else "all of them, so none is left out"
    return f"lost before: {before}{f' ({treated})' if before != 'none' else ''}; lost after: {after}"


def lowered(result: TuneResult, metric: str) -> np.ndarray:
    """`TuneResult.lowered`, or NaN where the controller before held no scenario."""
    if result.held[0].any():
        return result.lowered(metric)
    return np.full((len(result.spec.experiment.stiffness), 3), np.nan)


def worst_margins(result: TuneResult, kind: str) -> list[tuple[str, str]]:
    """Every margin at its worst over the judged tissues, before and after, in the unit of `margin_heads`."""
    found = result.margins[kind]
    columns = [map(row.entry, row.worst(getattr(found, name), axis=1)) for name, row in MARGINS.items()]
    return [(before, after) for before, after in columns]


def margin_heads() -> list[str]:
    """Headings of `worst_margins`."""
    return [margin.heading for margin in MARGINS.values()]


def shown(metric: Metric, value: float) -> str:
    """A value in the unit of the metric's heading."""
    return metric.entry(value) if np.isfinite(value) else "unstable"


def percent(share: float) -> str:
    """How far something fell, as a change."""
    # Without a zero that is negative.
    return f"{round(-100.0 * share, 1) + 0.0:+.1f} %" if np.isfinite(share) else "–"


def brief(value: np.ndarray) -> str:
    """A value, or the range of a diagonal."""
    return f"{value:.4g}" if value.ndim == 0 else f"{value.min():.2g}…{value.max():.2g}"


def _goals(result: TuneResult) -> Iterator[str]:
    yield f"{'goal':<32} {'before':>10} {'after':>10}  met"
    for row in rows(result):
        place = f", worst at {row.at:.4g} N/m" if row.at else ""
        values = " ".join(f"{value:>10.4g}" for value in row.reached)
        yield f"{f'{row.kind}: {row.text}':<32} {values}  {'yes' if row.met else 'no'}{place}"
    spec = result.spec
    kind = "ideal damping" if spec.ideal else "loop as it runs"
    yield f"margins: {kind}; soft goals: {spec.risk.kind} over {len(spec.tune.train_seeds)} scenarios in training"


def _parameters(result: TuneResult) -> Iterator[str]:
    yield f"{'parameter':<10} {'before':>12} {'after':>12}  unit"
    for axis in result.spec.space.axes:
        values = (brief(np.asarray(getattr(params, axis.name))) for params in (result.spec.before, result.params))
        yield f"{axis.name:<10} " + " ".join(f"{value:>12}" for value in values) + f"  {PARAMETERS[axis.name].unit}"


def _heldout(result: TuneResult, metric: Metric) -> Iterator[str]:
    yield f"{metric.text}: {metric.heading}, worst of the held-out scenarios, and how far it fell over all of them"
    yield f"{'K_s [N/m]':<10} " + " ".join(f"{axis + ' before':>9} {'after':>7} {'':>8}" for axis in AXES)
    fell = lowered(result, metric.name)
    for i, K_s in enumerate(result.spec.experiment.stiffness):
        cells = getattr(result.heldout, metric.name)[:, kept(result), i].max(axis=1)
        row = (
            f"{shown(metric, cells[0, a]):>9} {shown(metric, cells[1, a]):>7} {percent(fell[i, a]):>8}"
            for a in range(3)
        )
        yield f"{K_s:<10g} " + " ".join(row)
    yield f"least {percent(fell.min())}, median {percent(float(np.median(fell)))}"


def _spans(seeds: tuple[int, ...]) -> str:
    """Seeds, those in a row as a span."""
    found: list[list[int]] = []
    for seed in sorted(seeds):
        if found and seed == found[-1][-1] + 1:
            found[-1].append(seed)
        else:
            found.append([seed])
    spans = (f"{span[0]}–{span[-1]}" if len(span) > 2 else ", ".join(map(str, span)) for span in found)
    return ", ".join(spans) or "none"
