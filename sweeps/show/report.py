"""A sweep for people: all its rows as one page to explore, the best ones as a table and with their curves."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.files.toml import toml_text
from jaxmpc.quantities import HIGHEST_M_S, MARGINS, METRICS, PARAMETERS
from jaxmpc.report.content import Candidates, Chart, Detail, Measure, Report, Section, Series, Swept, Table, measure
from jaxmpc.report.influence import influence
from jaxmpc.report.page import write_report
from jaxmpc.report.thinning import thinned
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params, by_structure
from jaxmpc.terminal import layout
from sweeps.axis import SweepAxis
from sweeps.goal import MEASURED, SweepGoal
from sweeps.result import Result

GOALS = ("rms", "M_s", "chatter")
"""What the Pareto front shows first."""
MOST_ROWS = 100_000
"""Rows of a page; of a larger sweep the front, the best and an even sample of the others."""
MOST_DRAWN = 600_000
"""Values of drawn parameters, of which every bit is kept."""
PLOTTED, PLOTTED_ON_ARM = 12, 3
"""Rows of which curves are computed: the best, then the front."""
WINDOW = 6.0
"""Length of the end of a run that is kept of their forces [s]."""


def sweep_report(result: Result, path: Path, max_M_s: float | None = None, curves: bool = True) -> None:
    """Write the report of a sweep.

    Args:
        result: The sweep.
        path: Where it goes.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
        curves: Whether to compute the curves of the rows that matter; that takes compiling and a run.

    Raises:
        OSError: The file cannot be written.
    """
    shown = _sample(result, max_M_s)
    rows = candidates(shown, max_M_s)
    chosen = _that_matter(shown, max_M_s)
    if curves and chosen:
        rows = replace(rows, details=details(shown, chosen), note=_note(shown, len(chosen)))
    counts = ", ".join(f"{count} {name}" for name, count in result.status_counts().items() if count)
    lead = [
        f"{len(result)} rows on {len(result.plan.stiffness)} stiffnesses; row × stiffness: {counts}.",
        f"Result sha256 {result.hash}, spec {result.plan.spec_hash[:12]}.",
    ]
    if not result.complete:
        lead.append(f"Unfinished: {len(result)} of {len(result.plan.rows)} rows.")
    if len(shown) < len(result):
        lead.append(
            f"Shown are {len(shown)}: the Pareto front, the best 1000 and an even sample of the others; all are in the "
            "folder, and `--csv` writes them."
        )
    best = Section("Best rows", [caption(result, max_M_s)], [Table(*rendered(result, 10, max_M_s))])
    parts = [best, *_stages(result, max_M_s), *_base(result)]
    write_report(Report(f"Sweep of {_swept(result)}", lead, rows, parts, 0), path)


def candidates(result: Result, max_M_s: float | None = None) -> Candidates:
    """The rows of a sweep as a report takes them.

    Args:
        result: The sweep.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
    """
    swept = [_axis(axis, result[axis.name]) for axis in result.axes]
    limits = _goal(result, max_M_s).constraints
    ok = result["status"] == Status.OK
    found: list[Measure] = []
    for name in result.plan.kept:
        values = np.where(ok[..., None], result[name], np.nan) if name in METRICS else result[name]
        found.append(measure(MEASURED[name], values, limits.get(name)))
    # What is the same everywhere, as the clamped share of the linear loop, tells nothing.
    named = {*GOALS, *result.goal.names}
    told = [each for each in found if each.name in named or len(np.unique(each.values[np.isfinite(each.values)])) > 1]
    shown = [name for name in dict.fromkeys((result.goal.best, *GOALS)) if any(each.name == name for each in told)]
    return Candidates(
        names=[f"row {row}" for row in result["row"]],
        measures=[*swept, *told],
        status=result["status"],
        tissues=[f"{K_s:g} N/m" if K_s == K_s else f"tissue {k + 1}" for k, K_s in enumerate(result.plan.stiffness)],
        goals=shown[:3],
        toml=template(result),
        influence=influence(swept, told) if len(result) > 1 else {},
    )


def _axis(axis: SweepAxis, values: np.ndarray) -> Measure:
    """A swept parameter; of a choice the places of its values, which its text names."""
    if axis.name in PARAMETERS and axis.numeric and not axis.relative:
        return measure(PARAMETERS[axis.name], values)
    text = "of the base's" if axis.relative else "of the world" if axis.of_world else "of the controller"
    if not axis.numeric:
        text = "; ".join(f"{k}: {axis.label(k)}" for k in range(len(axis.values)))
    return Measure(axis.name, axis.name, axis.unit, text, values, "parameter", whole=not axis.numeric)


def _goal(result: Result, max_M_s: float | None) -> SweepGoal:
    return result.goal if max_M_s is None else result.goal.limited({"M_s": max_M_s})


def template(result: Result) -> list[str | Swept]:
    """A params.toml with places for the swept parameters; empty where a row's cannot be told from its columns.

    Args:
        result: The sweep.
    """
    own = [axis for axis in result.axes if not axis.of_world]
    if any(axis.relative or not axis.numeric for axis in own):
        return []
    text = toml_text({"params": result.plan.base.to_dict() | {axis.name: f"<{axis.name}>" for axis in own}})
    pieces = re.split(r'"<(\w+)>"', text)
    head: list[str | Swept] = ["# ", Swept("row"), f" of a sweep, spec {result.plan.spec_hash}\n"]
    for axis in result.axes:
        if axis.of_world:
            head += [f"# It met {axis.name} = ", Swept(axis.name), "\n"]
    head.append("# Freeze it: jaxmpc freeze params.toml -o controller.npz\n")
    return [*head, *(Swept(piece) if k % 2 else piece for k, piece in enumerate(pieces))]


def details(result: Result, places: Sequence[int]) -> dict[int, Detail]:
    """Loops and forces of some rows, computed anew.

    Args:
        result: The sweep.
        places: Of the rows.
    """
    from jaxmpc.report.charts import LoopCurve, loop_charts
    from jaxmpc.report.loops import curves

    found = {}
    for place, (params, experiment, force) in zip(places, _runs(result, places), strict=True):
        first = max(0, experiment.steps - round(WINDOW / experiment.sampling_time))
        time = np.arange(first, experiment.steps) * experiment.sampling_time
        wanted = experiment.signals.force_ref[first : experiment.steps]
        curve = curves(params, experiment, experiment.loop_path().ideal)
        stable = result["status"][place] != Status.UNSTABLE
        names = [f"{K_s:g} N/m" for K_s in experiment.stiffness]
        loops = [LoopCurve(name, curve, i, i, bool(stable[i])) for i, name in enumerate(names)]
        charts = [
            Chart(
                f"residual force, {axis.upper()}",
                "time [s]",
                "residual [mN]",
                [
                    Series(name, *thinned(time, 1e3 * (force[i, a, first:] - wanted[:, a])), i)
                    for i, name in enumerate(names)
                ],
            )
            for a, axis in enumerate(AXES)
        ]
        toml = toml_text({"params": params.to_dict()}, f"Row {result['row'][place]} of a sweep")
        charts += loop_charts(f"row {result['row'][place]}", loops, HIGHEST_M_S)
        found[int(place)] = Detail(charts, "" if template(result) else toml)
    return found


def _runs(result: Result, places: Sequence[int]) -> Iterator[tuple[Params, Experiment, np.ndarray]]:
    """Controller, world and measured force (stiffness, 3, steps) [N] of some rows, run again, many at once."""
    import jax

    from jaxmpc import evaluate

    controllers = [result.controller(place) for place in places]
    worlds = [result.experiment(place) for place in places]
    forces: dict[int, np.ndarray] = {}
    for alike in by_structure(controllers):
        for world in dict.fromkeys(repr(worlds[k].to_dict()) for k in alike):
            together = [k for k in alike if repr(worlds[k].to_dict()) == world]
            batch = Params.stack([controllers[k] for k in together])
            traced = evaluate(batch, worlds[together[0]], trace=True).trace
            assert traced is not None
            for i, k in enumerate(together):
                forces[k] = np.asarray(jax.tree.map(lambda leaf, i=i: leaf[i], traced.force))
    for k, (params, world_met) in enumerate(zip(controllers, worlds, strict=True)):
        yield params, world_met, forces[k]


def table(result: Result, n: int = 10, max_M_s: float | None = None) -> str:
    """The best rows as aligned text: swept parameters, worst-case residual and margins.

    Args:
        result: The sweep.
        n: Rows at most.
        max_M_s: Largest accepted worst-case peak sensitivity [-]; None is the spec's.
    """
    head, lines = rendered(result, n, max_M_s)
    if not lines:
        stable = int((result["status"] == Status.OK).all(axis=1).sum())
        limit = _goal(result, max_M_s).constraints.get("M_s", np.inf)
        return f"no row has M_s ≤ {limit:g} at every stiffness; {stable} of {len(result)} are stable at every one"
    return f"{caption(result, max_M_s)}\n\n{layout.table(head, lines)}"


def caption(result: Result, max_M_s: float | None) -> str:
    """What the table of the best rows shows."""
    return f"best rows: {_goal(result, max_M_s).text}; RMS, M_s and margins are the worst over stiffness (and axis)"


RESIDUALS = ("rms", "true_rms")
"""As the sensor reads it, which is what ranks, and of the force itself."""


def rendered(result: Result, n: int, max_M_s: float | None) -> tuple[list[str], list[list[str]]]:
    """Headings and lines of the table of the best rows."""
    best = result.best(n, max_M_s)
    swept = result.axes
    residuals = [name for name in RESIDUALS if name in result.columns]
    margins = {name: margin for name, margin in MARGINS.items() if name in result.columns}
    shown = [*(METRICS[name] for name in residuals), *margins.values()]
    units = ("" if axis.unit == "-" else f" [{axis.unit}]" for axis in swept)
    head = ["row", *(axis.name + unit for axis, unit in zip(swept, units, strict=True))]
    head += [quantity.heading for quantity in shown]
    columns: list[Any] = []
    columns += [METRICS[name].times * best[name].max(axis=(1, 2)) for name in residuals]
    columns += [margin.times * margin.worst(best[name], axis=1) for name, margin in margins.items()]
    lines = []
    for k, row in enumerate(best["row"]):
        settings = [axis.label(float(best[axis.name][k])) for axis in swept]
        lines.append([f"{row}", *settings, *(f"{column[k]:.4g}" for column in columns)])
    return head, lines


def _that_matter(result: Result, max_M_s: float | None) -> list[int]:
    """Places of the rows whose curves are worth computing: half of them the best, the others along the front."""
    most = PLOTTED if result.plan.canonical["experiment"]["physics"] == "linear" else PLOTTED_ON_ARM
    best = result.best(-(-most // 2), max_M_s)["row"].tolist()
    front = result.pareto()["row"]
    even = front[np.unique(np.linspace(0, len(front) - 1, most).round().astype(int))].tolist() if len(front) else []
    chosen = list(dict.fromkeys([*best, *even]))[:most]
    return [int(np.flatnonzero(result["row"] == row)[0]) for row in chosen]


def _sample(result: Result, max_M_s: float | None) -> Result:
    """Not more rows than a page can hold: those that matter, and evenly of the others."""
    most = MOST_ROWS
    if result.plan.space.kind != "grid":
        most = min(most, MOST_DRAWN // len(result.plan.space.axes))
    if len(result) <= most:
        return result
    keep = np.zeros(len(result), bool)
    matter = np.concatenate([result.pareto()["row"], result.best(1000, max_M_s)["row"]])
    keep[np.isin(result["row"], matter)] = True
    others = np.flatnonzero(~keep)
    keep[others[np.linspace(0, len(others) - 1, most - int(keep.sum())).round().astype(int)]] = True
    return result.take(np.flatnonzero(keep))


def _note(result: Result, count: int) -> str:
    physics = "linear loop" if result.plan.canonical["experiment"]["physics"] == "linear" else "arm"
    return (
        f"the {count} best rows and rows of the front, recomputed on the {physics}: the last {WINDOW:g} s of the "
        "residual on each axis, |S|, Nyquist, Bode of L and a step."
    )


def _stages(result: Result, max_M_s: float | None) -> Iterator[Section]:
    """The best rows of every stage of a refined sweep, as each saw them."""
    for name, stage in result.stages:
        if len(stage):
            words = f"{len(stage)} rows on the {stage.plan.canonical['experiment']['physics']} loop."
            yield Section(f"Stage {name}", [words], [Table(*rendered(stage, 5, max_M_s))])


def _base(result: Result) -> list[Section]:
    base = result.baseline
    if base is None:
        return []
    return [Section("Base controller", [f"Worst RMS {1e3 * base.rms:.4g} mN, worst M_s {base.M_s:.4g}."])]


def _swept(result: Result) -> str:
    return ", ".join(axis.name for axis in result.axes)
