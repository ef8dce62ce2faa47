"""The part of the report that says why the result is as it is."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.report.content import Section, Table
from jaxmpc.report.loops import Curves, curves
from tuning.proof.found import FoundController
from tuning.proof.gradients import SCORE
from tuning.proof.limits import RELAXED, LimitStudy, limits
from tuning.proof.result import TuneResult
from tuning.proof.sensitivities import Sensitivities, sensitivities
from tuning.proof.split import CAUSES, Split, split
from tuning.reports.charts import sensitivity_charts, split_charts
from tuning.reports.sections import at_bounds
from tuning.search.state import FEASIBLE


class Study(NamedTuple):
    """What explains a result; it takes evaluations and programs of its own, so it is made once."""

    loops: tuple[Curves, Curves]
    """Before and after."""
    sensitivities: Sensitivities
    split: Split
    limits: LimitStudy


def study(result: FoundController) -> Study:
    """Everything in the report that the run itself has not computed and that needs no proof."""
    spec = result.spec
    before, after = (curves(params, spec.experiment, spec.ideal) for params in (spec.before, result.params))
    return Study((before, after), sensitivities(result), split(result), limits(result))


def explained(result: TuneResult, found: Study) -> list[Section]:
    """Sections of the page."""
    return [
        Section("What limits it", list(limits_text(result, found))),
        _split(result, found.split),
        _sensitivities(result, found.sensitivities),
    ]


def limits_text(result: TuneResult, found: Study) -> Iterator[str]:
    """What keeps the tuned controller from being better, in sentences."""
    for goal in found.limits.active:
        where = f" at {goal.place}" if goal.place else " in training"
        stands = "active" if goal.normalised <= FEASIBLE else "missed"
        line = f"The goal {goal.goal} is {stands}{where}: {100 * goal.normalised:.1f} % of its limit."
        if np.isfinite(goal.multiplier):
            line += f" With its limit relaxed by {100 * RELAXED:.0f} % the score would fall by some "
            line += f"{100 * goal.gain:.1f} % (multiplier {goal.multiplier:.2f}, to first order)."
        yield line
    for resting in at_bounds(result):
        yield f"{resting}: no slope and no price here tells what lies beyond."
    if not found.limits.active:
        yield "No hard goal is active: more steps, wider bounds or another structure may improve it."
    elif np.isfinite(found.limits.unexplained):
        yield (
            f"Active goals balance all but {100 * found.limits.unexplained:.0f} % of the score's slope. The more is "
            "left, the rougher are these estimates: more steps may still help, or the worst case stands at a kink."
        )
    whole = found.split.whole[1]
    if np.isfinite(whole).all():
        i, a = np.unravel_index(int(np.argmax(whole)), whole.shape)
        alone = {name: getattr(found.split, name)[1, i, a] for name in CAUSES}
        shares = (
            f"{name} {1e3 * force:.1f} mN ({100 * (force / whole[i, a]) ** 2:.0f} % of its power)"
            for name, force in alone.items()
            if force > 0.0
        )
        yield (
            f"The largest residual that the frequency response predicts, on the {AXES[a]} axis at "
            f"{result.spec.experiment.stiffness[i]:g} N/m, is {1e3 * whole[i, a]:.1f} mN. Alone would leave: "
            f"{', '.join(shares)}."
        )


def _split(result: TuneResult, parts: Split) -> Section:
    lines = []
    for i, K_s in enumerate(result.spec.experiment.stiffness):
        for a, axis in enumerate(AXES):
            both = (getattr(parts, name)[:, i, a] for name in ("whole", *CAUSES))
            lines.append(
                [f"{K_s:g} N/m, {axis}", *(f"{1e3 * before:.1f} → {1e3 * after:.1f}" for before, after in both)]
            )
    words = (
        "Root mean square that each cause alone would leave, from the frequency response of the linear loop and the "
        "spectra of the scenarios in training. Friction follows the heart's velocity, so squares do not add up."
    )
    if not np.nanmax(parts.friction, initial=0.0) > 0.0:
        words += " The linear world has no friction."
    head = ("tissue, axis", "all together [mN]", *(f"{name} [mN]" for name in CAUSES))
    return Section("Causes of the residual", [words], [Table(head, lines)], split_charts(result, parts))


def _sensitivities(result: TuneResult, found: Sensitivities) -> Section:
    stiffness = result.spec.experiment.stiffness
    lines = [
        [f"{metric} at {K_s:g} N/m", f"{value:.4g}", *map(_signed, found.slopes[k, :, i])]
        for k, metric in enumerate(found.metrics)
        for i, (K_s, value) in enumerate(zip(stiffness, found.values[k], strict=True))
    ]
    of = "the spectra as a run of the arm corrects them" if result.spec.on_arm else "the loop"
    words = (
        f"Change of each metric in per cent per per cent of a parameter, of the tuned controller on each tissue alone: "
        f"exact gradients of {of}. The {SCORE} stands for the soft goals "
        f"({', '.join(result.spec.soft)}; worst axis and scenario), margins are relative to their limits. Horizons are "
        "whole, so theirs is the change over a sample to either side, – where the loop is unstable there."
    )
    charts = list(sensitivity_charts(result, found))
    return Section(
        "Sensitivity to the parameters", [words], [Table(("metric", "value", *found.parameters), lines)], charts
    )


def _signed(slope: float) -> str:
    if np.isnan(slope):
        return "–"
    return f"{slope:+.3f}" if not abs(slope) < 0.0005 else "0"
