"""The page of a comparison: the table, the contenders as rows, and everything drawn over each other."""

from typing import Any

import jax
import numpy as np

from jaxmpc.files.toml import toml_text
from jaxmpc.quantities import HIGHEST_M_S, MARGINS, METRICS, PARAMETERS
from jaxmpc.report.charts import LoopCurve, force_charts, loop_charts, margin_charts
from jaxmpc.report.comparison import Comparison, known_margins
from jaxmpc.report.content import Candidates, Chart, Detail, Report, Section, measure
from jaxmpc.report.loops import Curves, curves
from jaxmpc.report.side_by_side import CONFIDENCE, table
from jaxmpc.stability import Margins, margins
from jaxmpc.synthesis.params import Params

SPAN, STIFFNESSES = (0.6, 1.6), 41
"""How far beyond the experiment's tissues margins are drawn [-], and at how many stiffnesses."""
SHOWN_S = 6.0
"""Length of the end of a run whose forces are drawn [s]."""


def report_of(found: Comparison) -> Report:
    """The report: the table, the contenders as rows, and everything drawn over each other."""
    experiment, contenders = found.experiment, found.contenders
    seeds = 0 if found.drawn is None else found.drawn.rms.shape[1]
    lead = [f"{one.name}: {one.origin}." for one in contenders]
    words = f"On {experiment.name}, {experiment.duration:g} s, physics {experiment.physics}."
    if seeds:
        words += f" Differences are means over {seeds} {experiment.draws} that all met, ± the half-width of their "
        words += (
            f"{100 * CONFIDENCE:.0f} % interval (Student, paired); * where it does not hold zero. Where a controller "
        )
        words += "was lost on some, the difference is over the others, whose number stands behind it."
    sections = [
        Section("Side by side", [words], [table(found)]),
        Section(
            "Force", [f"The last {SHOWN_S:g} s of the residual, on the experiment itself."], (), _force_charts(found)
        ),
        Section(
            "Loops",
            [
                "L is cut where its sensitivity peaks higher. A family knows the tissue. "
                "The step is that of the linear loop."
            ],
            (),
            _loop_charts(found),
        ),
        Section("Margins over stiffness", _known_words(found), (), _margin_charts(found)),
    ]
    return Report(" against ".join(one.name for one in contenders), lead, _rows(found), sections, len(sections))


def _rows(found: Comparison) -> Candidates:
    """The contenders as rows that can be explored."""
    contenders = found.contenders
    given = [one.params.numbers for one in contenders]
    numbers = {
        name: np.array([np.mean(np.asarray(values.get(name, np.nan))) for values in given])
        for name in PARAMETERS
        if any(name in values for values in given)
    }
    measures = [measure(PARAMETERS[name], values) for name, values in numbers.items()]
    for name, metric in METRICS.items():
        values = np.stack([np.asarray(getattr(one.metrics, name)) for one in found.outcomes])
        if np.isfinite(values).any():
            measures.append(measure(metric, values))
    for name, margin in MARGINS.items():
        limit = HIGHEST_M_S if name == "M_s" else None
        measures.append(
            measure(margin, np.stack([np.asarray(getattr(one.margins, name)) for one in found.outcomes]), limit)
        )
    texts = [toml_text({"params": one.params.to_dict()}, one.origin) for one in contenders]
    return Candidates(
        names=[one.name for one in contenders],
        measures=measures,
        status=np.stack([np.asarray(one.status) for one in found.outcomes]),
        tissues=[f"{K_s:g} N/m" for K_s in found.experiment.stiffness],
        goals=("rms", "M_s", "chatter"),
        details={k: Detail(toml=text) for k, text in enumerate(texts)},
        note="every controller's curves are drawn over each other above.",
    )


def _force_charts(found: Comparison) -> list[Chart]:
    experiment = found.experiment
    first = max(0, experiment.steps - round(SHOWN_S / experiment.sampling_time))
    time = np.arange(first, experiment.steps) * experiment.sampling_time
    forces = []
    for one, outcome in zip(found.contenders, found.outcomes, strict=True):
        assert outcome.trace is not None
        forces.append((one.name, np.asarray(outcome.trace.force)[..., first:]))
    return force_charts(time, experiment.stiffness, forces, experiment.signals.force_ref[first : experiment.steps])


def _loop_charts(found: Comparison) -> list[Chart]:
    experiment = found.experiment
    ideal = experiment.loop_path().ideal
    drawn: list[Curves] = [curves(one.params, experiment, ideal) for one in found.contenders]
    charts = []
    for i, K_s in enumerate(experiment.stiffness):
        loops = [
            LoopCurve(one.name, curve, i, k, _radius(found, k, i) < 1.0)
            for k, (one, curve) in enumerate(zip(found.contenders, drawn, strict=True))
        ]
        charts += loop_charts(f"{K_s:g} N/m", loops, HIGHEST_M_S)
    return charts


def _radius(found: Comparison, contender: int, tissue: int) -> float:
    """Spectral radius of the loop whose curves are drawn."""
    known = found.known[contender]
    judged = found.outcomes[contender].margins if known is None else known
    return float(np.asarray(judged.spectral_radius)[tissue])


def _margin_charts(found: Comparison) -> list[Chart]:
    stiffness = found.experiment.stiffness
    grid = np.geomspace(SPAN[0] * min(stiffness), SPAN[1] * max(stiffness), STIFFNESSES)
    path = found.experiment.loop_path()
    named: list[tuple[str, Any]] = []
    for one in found.contenders:
        named.append((one.name, _over(one.params, grid, path)))
    return margin_charts(grid, named, {"M_s": HIGHEST_M_S})


def _over(params: Params, grid: np.ndarray, path: Any) -> Margins:
    """Margins over stiffness; those of a family with the stiffness known, between its outer knots."""
    if params.listening is None:
        return margins(params, grid, path=path)
    knots = params.listening.stiffness
    found = known_margins(params, np.clip(grid, knots[0], knots[-1]).tolist(), path)
    assert found is not None
    inside = (grid >= knots[0]) & (grid <= knots[-1])
    held: Margins = jax.tree.map(lambda field: np.where(inside, field, np.nan), found)
    return held


def _known_words(found: Comparison) -> list[str]:
    if all(each is None for each in found.known):
        return []
    return ["Of a family: with the stiffness known, the worst over its band, between its outer knots."]
