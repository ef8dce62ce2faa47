"""A sweep for people: all its rows as one page to explore, the best ones as a table and with their curves."""

import re
from collections.abc import Sequence
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
from jaxmpc.synthesis.params import Params
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


def sweep_report(result: Result, path: Path, max_M_s: float = HIGHEST_M_S, curves: bool = True) -> None:
    """Write the report of a sweep.

    Args:
        result: The sweep.
        path: Where it goes.
        max_M_s: Largest accepted peak sensitivity [-].
        curves: Whether to compute the curves of the rows that matter; that takes compiling and a run.

    Raises:
        OSError: The file cannot be written.
    """
    shown = _sample(result, max_M_s)
    rows = candidates(shown, max_M_s)
    chosen = _that_matter(shown, max_M_s)
    # Of a recording the folder has only the hash.
    if curves and chosen and not result.plan.canonical["experiment"]["motion"]["file"]:
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
    best = Section("Best rows", [caption(max_M_s)], [Table(*rendered(result, 10, max_M_s))])
    write_report(Report(f"Sweep of {_swept(result)}", lead, rows, [best, *_base(result)], 0), path)


def candidates(result: Result, max_M_s: float = HIGHEST_M_S) -> Candidates:
    """The rows of a sweep as a report takes them.

    Args:
        result: The sweep.
        max_M_s: Largest accepted peak sensitivity [-].
    """
    swept = [measure(PARAMETERS[axis.name], result[axis.name]) for axis in result.plan.space.axes]
    ok = result["status"] == Status.OK
    found: list[Measure] = []
    for name, metric in METRICS.items():
        if name in result.columns:
            found.append(measure(metric, np.where(ok[..., None], result[name], np.nan)))
    for name, margin in MARGINS.items():
        if name in result.columns:
            found.append(measure(margin, result[name], max_M_s if name == "M_s" else None))
    # What is the same everywhere, as the clamped share of the linear loop, tells nothing.
    told = [each for each in found if each.name in GOALS or len(np.unique(each.values[np.isfinite(each.values)])) > 1]
    return Candidates(
        names=[f"row {row}" for row in result["row"]],
        measures=[*swept, *told],
        status=result["status"],
        tissues=[f"{K_s:g} N/m" for K_s in result.plan.stiffness],
        goals=[name for name in GOALS if any(each.name == name for each in told)],
        toml=template(result.plan.base, [axis.name for axis in result.plan.space.axes], result.hash),
        influence=influence(swept, told) if len(result) > 1 else {},
    )


def template(base: Params, swept: Sequence[str], origin: str) -> list[str | Swept]:
    """A params.toml with places for the swept parameters.

    Args:
        base: The controller that all rows begin with.
        swept: Names of parameters.
        origin: Hash of the result.
    """
    text = toml_text({"params": base.to_dict() | {name: f"<{name}>" for name in swept}})
    pieces = re.split(r'"<(\w+)>"', text)
    head = f" of a sweep, result {origin}\n# Freeze it: jaxmpc freeze params.toml -o controller.npz\n"
    return ["# ", Swept("row"), head, *(Swept(piece) if k % 2 else piece for k, piece in enumerate(pieces))]


def details(result: Result, places: Sequence[int]) -> dict[int, Detail]:
    """Loops and forces of some rows, computed anew.

    Args:
        result: The sweep.
        places: Of the rows.
    """
    from jaxmpc import evaluate
    from jaxmpc.report.charts import LoopCurve, loop_charts
    from jaxmpc.report.loops import curves

    experiment = Experiment.from_dict(_experiment(result))
    controllers = [result.controller(place) for place in places]
    traced = evaluate(Params.stack(controllers), experiment, trace=True)
    assert traced.trace is not None
    forces = np.asarray(traced.trace.force) if experiment.physics == "linear" else np.stack(traced.trace.force, -2)
    first = max(0, experiment.steps - round(WINDOW / experiment.sampling_time))
    time = np.arange(first, experiment.steps) * experiment.sampling_time
    wanted = experiment.signals.force_ref[first : experiment.steps]
    found = {}
    for k, (place, params) in enumerate(zip(places, controllers, strict=True)):
        curve = curves(params, experiment, experiment.loop_path().ideal)
        stable = result["status"][place] != Status.UNSTABLE
        loops = [LoopCurve(f"{K_s:g} N/m", curve, i, i, bool(stable[i])) for i, K_s in enumerate(experiment.stiffness)]
        charts = [
            Chart(
                f"residual force, {axis.upper()}",
                "time [s]",
                "residual [mN]",
                [
                    Series(f"{K_s:g} N/m", *thinned(time, 1e3 * (forces[k, i, a, first:] - wanted[:, a])), i)
                    for i, K_s in enumerate(experiment.stiffness)
                ],
            )
            for a, axis in enumerate(AXES)
        ]
        found[int(place)] = Detail([*charts, *loop_charts(str(result["row"][place]), loops, HIGHEST_M_S)])
    return found


def table(result: Result, n: int = 10, max_M_s: float = HIGHEST_M_S) -> str:
    """The best rows as aligned text: swept parameters, worst-case residual and margins.

    Args:
        result: The sweep.
        n: Rows at most.
        max_M_s: Largest accepted worst-case peak sensitivity [-].
    """
    head, lines = rendered(result, n, max_M_s)
    if not lines:
        stable = int((result["status"] == Status.OK).all(axis=1).sum())
        return f"no row has M_s ≤ {max_M_s:g} at every stiffness; {stable} of {len(result)} are stable at every one"
    widths = [max(map(len, column)) for column in zip(head, *lines, strict=True)]
    text = ["  ".join(map(str.rjust, line, widths)) for line in (head, *lines)]
    return "\n".join([caption(max_M_s), *text])


def caption(max_M_s: float) -> str:
    """What the table of the best rows shows."""
    return f"best rows with M_s ≤ {max_M_s:g}; RMS, M_s and margins are the worst over stiffness (and axis)"


RESIDUALS = ("rms", "true_rms")
"""As the sensor reads it, which is what ranks, and of the force itself."""


def rendered(result: Result, n: int, max_M_s: float) -> tuple[list[str], list[list[str]]]:
    """Headings and lines of the table of the best rows."""
    best = result.best(n, max_M_s)
    swept = [axis.name for axis in result.plan.space.axes]
    residuals = [name for name in RESIDUALS if name in result.columns]
    margins = {name: margin for name, margin in MARGINS.items() if name in result.columns}
    shown = [*(PARAMETERS[name] for name in swept), *(METRICS[name] for name in residuals), *margins.values()]
    head = ["row", *(quantity.heading for quantity in shown)]
    columns: list[Any] = [best["row"], *(best[name] for name in swept)]
    columns += [METRICS[name].times * best[name].max(axis=(1, 2)) for name in residuals]
    columns += [margin.times * margin.worst(best[name], axis=1) for name, margin in margins.items()]
    lines = [[f"{row}", *(f"{value:.4g}" for value in values)] for row, *values in zip(*columns, strict=True)]
    return head, lines


def _that_matter(result: Result, max_M_s: float) -> list[int]:
    """Places of the rows whose curves are worth computing: half of them the best, the others along the front."""
    most = PLOTTED if result.plan.canonical["experiment"]["physics"] == "linear" else PLOTTED_ON_ARM
    best = result.best(-(-most // 2), max_M_s)["row"].tolist()
    front = result.pareto()["row"]
    even = front[np.unique(np.linspace(0, len(front) - 1, most).round().astype(int))].tolist() if len(front) else []
    chosen = list(dict.fromkeys([*best, *even]))[:most]
    return [int(np.flatnonzero(result["row"] == row)[0]) for row in chosen]


def _sample(result: Result, max_M_s: float) -> Result:
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


def _experiment(result: Result) -> dict[str, Any]:
    return {**result.plan.canonical["experiment"], "name": "sweep"}


def _base(result: Result) -> list[Section]:
    base = result.baseline
    if base is None:
        return []
    return [Section("Base controller", [f"Worst RMS {1e3 * base.rms:.4g} mN, worst M_s {base.M_s:.4g}."])]


def _swept(result: Result) -> str:
    return ", ".join(axis.name for axis in result.plan.space.axes)
