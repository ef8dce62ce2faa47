"""A tuning run as plain text: parameters, the table before and after, and how it stands to its goals."""

from collections.abc import Iterator

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.synthesis.params import BOUNDS
from tuning.job.result import KINDS, TuneResult
from tuning.job.scenarios import describe
from tuning.proof.limits import active_margins
from tuning.proof.reached import kept, rows, verdict
from tuning.search.state import FEASIBLE

MARGIN_HEADS = ("M_s", "gain up dB", "gain down dB", "phase deg", "delay ms")
METRICS = (("rms", "residual RMS"), ("peak_to_peak", "residual peak to peak"))


def report(result: TuneResult) -> str:
    """The whole result as plain text."""
    spec, (before, after) = result.spec, result.worst
    change = f" ({-100 * result.gain:+.1f} %)" if np.isfinite(result.gain) else ""
    lines = [verdict(result), "", *_goals(result), "", *_parameters(result), ""]
    lines += [f"{name}: {seeds}" for name, seeds in seeds_used(result)]
    lines += [lost_text(result)] if not result.held.all() else []
    for metric, title in METRICS:
        lines += ["", *_heldout(result, metric, title)]
    lines.append(f"worst RMS of all: {millinewton(before)} → {millinewton(after)} mN{change}")
    lines += ["", f"worst margins over {spec.judged_at[0]:g}–{spec.judged_at[-1]:g} N/m, after (before)"]
    lines.append(f"{'loop':<8}" + "".join(f"{name:>18}" for name in MARGIN_HEADS))
    for kind in KINDS:
        pairs = worst_margins(result, kind)
        lines.append(f"{kind:<8}" + "".join(f"{f'{after:.2f} ({before:.2f})':>18}" for before, after in pairs))
    for name, K_s, normalised in active_margins(result):
        stands = "active" if normalised <= FEASIBLE else "missed"
        lines.append(f"{name} is {stands} at {K_s:.4g} N/m, {100 * normalised:.1f} % of its limit")
    lines.append("")
    for step in result.steps:
        state = step.state
        skipped = f", {int(state.skipped.sum())} steps skipped for a gradient not finite" if state.skipped.any() else ""
        added = f"; added {describe(step.added.trained)}" if step.added else ""
        score = f"{state.best.min():.4f}" if state.feasible else "no feasible point"
        lines.append(f"{step.name}: {state.look} looks at {len(state.z)} starts, score {score}{skipped}{added}")
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


def worst_margins(result: TuneResult, kind: str) -> list[tuple[float, float]]:
    """Each of `MARGIN_HEADS` at its worst over the judged tissues, before and after."""
    m = result.margins[kind]
    columns = [np.max(m.M_s, axis=1), *(np.min(field, axis=1) for field in m[1:5])]
    columns[4] = 1e3 * columns[4]
    return [(float(before), float(after)) for before, after in columns]


def millinewton(force: float) -> str:
    """A force in millinewton."""
    return f"{1e3 * force:.1f}" if np.isfinite(force) else "unstable"


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
        yield f"{axis.name:<10} " + " ".join(f"{value:>12}" for value in values) + f"  {BOUNDS[axis.name][2]}"


def _heldout(result: TuneResult, metric: str, title: str) -> Iterator[str]:
    yield f"{title}, worst of the held-out scenarios [mN] and how far it fell over all of them"
    yield f"{'K_s [N/m]':<10} " + " ".join(f"{axis + ' before':>9} {'after':>7} {'':>8}" for axis in AXES)
    fell = lowered(result, metric)
    for i, K_s in enumerate(result.spec.experiment.stiffness):
        cells = getattr(result.heldout, metric)[:, kept(result), i].max(axis=1)
        row = (
            f"{millinewton(cells[0, a]):>9} {millinewton(cells[1, a]):>7} {percent(fell[i, a]):>8}" for a in range(3)
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
