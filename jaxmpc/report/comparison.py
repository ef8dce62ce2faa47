"""Controllers side by side on one experiment: what each leaves, how they differ over drawn motions, how loops look."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmpc import evaluate
from jaxmpc.closed_loops import Outcome
from jaxmpc.experiment import Experiment
from jaxmpc.files.toml import toml_text
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import AXES, HIGHEST_M_S, MARGINS, METRICS, PARAMETERS, Quantity
from jaxmpc.report.charts import LoopCurve, force_charts, loop_charts, margin_charts
from jaxmpc.report.content import Candidates, Chart, Detail, Report, Section, Table, measure
from jaxmpc.report.loops import Curves, curves
from jaxmpc.stability import Margins, margins
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.synthesis.params import Params, by_structure

CONFIDENCE = 0.95
"""Probability that an interval of differences holds the mean [-]."""
PER_AXIS = ("rms", "true_rms", "peak_to_peak", "true_peak_to_peak")
"""Metrics that are shown on every axis; of the others the worst."""
SPAN, STIFFNESSES = (0.6, 1.6), 41
"""How far beyond the experiment's tissues margins are drawn [-], and at how many stiffnesses."""
SHOWN_S = 6.0
"""Length of the end of a run whose forces are drawn [s]."""
KNOWN = "stiffness known: "
"""Before the margins of families whose schedule has the control."""


class Contender(NamedTuple):
    """One of those that are compared."""

    name: str
    params: Params
    origin: str
    """Where it comes from, in words."""


class Entry(NamedTuple):
    """One row of the table."""

    quantity: Quantity
    label: str
    """What it is; with its unit."""
    place: str
    """Tissue and axis."""
    values: np.ndarray
    """One of every contender, on the experiment itself, (contenders,)."""
    drawn: np.ndarray | None
    """On the drawn motions, (contenders, seeds); None where no motion matters."""


class PairedDifference(NamedTuple):
    """How much more one has than the first, over the same motions."""

    mean: float
    half_width: float
    """Half of the interval in which the mean lies with `CONFIDENCE`; NaN of a single pair."""

    @property
    def told(self) -> bool:
        """Whether zero lies outside the interval."""
        return abs(self.mean) > self.half_width


@dataclass(frozen=True)
class Comparison:
    """What was found.

    Attributes:
        experiment: What all met.
        contenders: In the order given; differences are to the first.
        outcomes: Of the experiment itself, with traces.
        drawn: Metrics on the drawn motions, fields (contenders, seeds, stiffness, 3).
        known: Margins with the stiffness known, fields (stiffness,); None of one without a schedule.
        ratios: Residual over the least of any linear law, (contenders, stiffness, 3) [-]; None where not asked for.
    """

    experiment: Experiment
    contenders: Sequence[Contender]
    outcomes: Sequence[Outcome]
    drawn: Metrics | None
    known: Sequence[Margins | None]
    ratios: np.ndarray | None = None

    @property
    def entries(self) -> list[Entry]:
        """The whole table."""
        return list(_entries(self))


def compared(
    contenders: Sequence[Contender],
    experiment: Experiment,
    seeds: Sequence[int] = (),
    *,
    ratios: np.ndarray | None = None,
    said: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Run all contenders on the experiment and on drawn motions.

    Args:
        contenders: Two or more, or one alone.
        experiment: What they meet.
        seeds: Draw phases, rhythm and noise anew; every contender meets the same.
        ratios: See `Comparison`.
        said: Takes a line of progress.
    """
    said(f"on {experiment.name} itself …")
    own = _run(contenders, experiment, traced=True)
    each = []
    for k, seed in enumerate(seeds):
        said(f"motion {k + 1} of {len(seeds)} (seed {seed}) …")
        each.append([outcome.metrics for outcome in _run(contenders, experiment.with_seed(seed), traced=False)])
    drawn = None
    if each:
        # (seeds, contenders, …) → (contenders, seeds, …)
        drawn = jax.tree.map(lambda *fields: np.stack(fields), *(_stacked(row) for row in each))
        drawn = jax.tree.map(lambda field: np.swapaxes(field, 0, 1), drawn)
    path = experiment.loop_path()
    known = [known_margins(one.params, experiment.stiffness, path) for one in contenders]
    return Comparison(experiment, contenders, own, drawn, known, ratios)


def known_margins(params: Params, stiffness: Sequence[float], path: Any) -> Margins | None:
    """Margins of a family where the stiffness is known, the worst over its band; None without a schedule."""
    if params.listening is None:
        return None
    _, band = judged_where(params.listening)
    found = family_margins(params, stiffness, band, path)
    worst = {name: row.worst(np.asarray(getattr(found, name)), axis=-1) for name, row in MARGINS.items()}
    return Margins(**worst, status=found.status.max(axis=-1))


def difference(first: np.ndarray, other: np.ndarray) -> PairedDifference:
    """Paired difference over motions that both held, with its Student interval.

    Args:
        first: (seeds,).
        other: (seeds,).
    """
    from scipy.stats import t

    apart = (other - first)[np.isfinite(other - first)]
    if not len(apart):
        return PairedDifference(np.nan, np.nan)
    if len(apart) == 1:
        return PairedDifference(float(apart[0]), np.nan)
    spread = float(np.std(apart, ddof=1)) / np.sqrt(len(apart))
    return PairedDifference(float(apart.mean()), float(t.ppf(0.5 + CONFIDENCE / 2.0, len(apart) - 1)) * spread)


def table(found: Comparison) -> Table:
    """One row per quantity, tissue and axis: every contender, then every other minus the first with its interval."""
    names = [one.name for one in found.contenders]
    head = ["", "K_s, axis", *names, *(f"{name} − {names[0]}" for name in names[1:])]
    rows = []
    for entry in found.entries:
        cells = [entry.quantity.entry(value) for value in entry.values]
        rows.append([entry.label, entry.place, *cells, *_differences(entry)])
    return Table(head, rows)


def report_of(found: Comparison) -> Report:
    """The report: the table, the contenders as rows, and everything drawn over each other."""
    experiment, contenders = found.experiment, found.contenders
    seeds = 0 if found.drawn is None else found.drawn.rms.shape[1]
    lead = [f"{one.name}: {one.origin}." for one in contenders]
    words = f"On {experiment.name}, {experiment.duration:g} s, physics {experiment.physics}."
    if seeds:
        words += f" Differences are means over {seeds} drawn motions that all met, ± the half-width of their "
        words += f"{100 * CONFIDENCE:.0f} % interval (Student, paired); * where it does not hold zero."
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


def _run(contenders: Sequence[Contender], experiment: Experiment, *, traced: bool) -> list[Outcome]:
    """Outcomes in the order of the contenders; those of one structure are one batch."""
    found: dict[int, Outcome] = {}
    for alike in by_structure([one.params for one in contenders]):
        batch = evaluate(Params.stack([contenders[i].params for i in alike]), experiment, trace=traced)
        host = jax.tree.map(np.asarray, batch)
        for k, i in enumerate(alike):
            found[i] = jax.tree.map(lambda leaf, k=k: leaf[k], host)
    return [found[i] for i in range(len(contenders))]


def _stacked(row: Sequence[Metrics]) -> Metrics:
    stacked: Metrics = jax.tree.map(lambda *fields: np.stack(fields), *row)
    return stacked


def _entries(found: Comparison) -> Iterator[Entry]:
    tissues = [f"{K_s:g} N/m" for K_s in found.experiment.stiffness]
    for name, metric in METRICS.items():
        values = np.stack([np.asarray(getattr(one.metrics, name)) for one in found.outcomes])
        drawn = None if found.drawn is None else np.asarray(getattr(found.drawn, name))
        if not np.isfinite(values).any() or not (np.nan_to_num(values) != 0.0).any():
            continue
        for i, tissue in enumerate(tissues):
            if name in PER_AXIS:
                for a, axis in enumerate(AXES):
                    place = f"{tissue}, {axis.upper()}"
                    over = None if drawn is None else drawn[:, :, i, a]
                    yield Entry(metric, metric.heading, place, values[:, i, a], over)
            else:
                over = None if drawn is None else metric.worst(drawn[:, :, i], axis=-1)
                yield Entry(metric, metric.heading, tissue, metric.worst(values[:, i], axis=-1), over)
    for name, margin in MARGINS.items():
        values = np.stack([np.asarray(getattr(one.margins, name)) for one in found.outcomes])
        for i, tissue in enumerate(tissues):
            yield Entry(margin, margin.heading, tissue, values[:, i], None)
    if any(each is not None for each in found.known):
        nothing = np.full(len(tissues), np.nan)
        for name, margin in MARGINS.items():
            values = np.stack([nothing if each is None else np.asarray(getattr(each, name)) for each in found.known])
            for i, tissue in enumerate(tissues):
                yield Entry(margin, KNOWN + margin.heading, tissue, values[:, i], None)
    if found.ratios is not None:
        ratio = Quantity("limit_ratio", "-", "residual over the least of any linear law", "", head="× limit")
        for i, tissue in enumerate(tissues):
            for a, axis in enumerate(AXES):
                yield Entry(ratio, ratio.heading, f"{tissue}, {axis.upper()}", found.ratios[:, i, a], None)


def _differences(entry: Entry) -> Iterator[str]:
    """Every other's difference to the first; without drawn motions that of the values."""
    times, digits = entry.quantity.times, entry.quantity.digits
    for k in range(1, len(entry.values)):
        if entry.drawn is None:
            apart = times * (entry.values[k] - entry.values[0])
            yield f"{apart:+.{digits}f}" if np.isfinite(apart) else "–"
            continue
        found = difference(entry.drawn[0], entry.drawn[k])
        if not np.isfinite(found.mean):
            yield "–"
            continue
        interval = f" ± {times * found.half_width:.{digits}f}" if np.isfinite(found.half_width) else ""
        yield f"{times * found.mean:+.{digits}f}{interval}{' *' if found.told else ''}"


def _rows(found: Comparison) -> Candidates:
    """The contenders as rows that can be explored."""
    contenders = found.contenders
    numbers = {
        name: np.array([np.mean(np.asarray(getattr(one.params, name))) for one in contenders]) for name in PARAMETERS
    }
    measures = [measure(row, numbers[name]) for name, row in PARAMETERS.items()]
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
        note="every controller's curves are drawn over each other below.",
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
