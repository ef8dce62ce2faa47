"""Table and picture of the runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.rivals.costs import Costs
from benchmarks.rivals.record import Run, Spent
from benchmarks.rivals.runs import COARSE, GRADIENT, PI, TEXTBOOK, rivals
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from tuning.job.spec import TuneSpec
from tuning.search.state import FEASIBLE

Runs = Mapping[str, Sequence[Run]]
"""Per name, one per seed."""
COLORS = {GRADIENT: TUNED, "random": BASELINE, "TPE": "#e0a030", "CMA-ES": ACCENT, PI: "#5c9e5c"}
RESOLVED = 1e-3
"""Smallest distance that the picture shows [-]."""
BAR, AIM = 1 / 5, 1 / 10
"""Share of the best rival's cost that the tuner may need, and the share that is aimed at."""


def median(values: Sequence[float]) -> float:
    """∞ where most are."""
    return float(np.median(values))


def bar(runs: Runs, spec: TuneSpec) -> tuple[str, float]:
    """The rival whose median best loss is the least, and that loss."""
    found = {name: median([run.best[-1] for run in runs[name]]) for name in rivals(spec)}
    name = min(found, key=lambda each: found[each])
    return name, found[name]


def table(runs: Runs, spec: TuneSpec, costs: Costs) -> str:
    """What everybody found and spent, and what the tuner needs for as much; medians over the seeds."""
    seeds, compiled = len(runs[GRADIENT]), ", ".join(f"{name} {s:.0f} s" for name, s in costs.compiled.items())
    lines = [
        f"{costs.machine}, {costs.devices} devices; {spec.experiment.name}, {costs.steps} steps an evaluation",
        f"{costs.rate / 1e6:.2f} M steps/s; a look at {spec.tune.starts} starts takes {costs.look:.2f} s, "
        f"{costs.cost_ratio:.2f} × their evaluation; both give the same loss to {costs.difference:.0e}",
        f"first calls, which compile and are left out below: {compiled}",
        f"medians over the seeds, {seeds}; loss = log risk + penalties, its range in brackets",
        "",
        f"{'':18}{'loss':>9}{'':20}{'risk':>8} {'feasible':>8} {'evals':>7} {'M steps':>8} {'wall':>7} {'CPU':>7} "
        f"{'own':>7}",
    ]
    for name, found in runs.items():
        losses = [run.best[-1] for run in found]
        spent = Spent(*np.median([run.spent[-1] for run in found], axis=0))
        own = median([run.own for run in found])
        feasible = sum(run.hard <= FEASIBLE for run in found)
        spread = f"[{min(losses):.4f}, {max(losses):.4f}]"
        lines.append(
            f"{name:18}{median(losses):9.4f} {spread:19}{median([run.score for run in found]):8.3f} "
            f"{feasible:>6}/{len(found)} {spent.evaluations:7.0f} {spent.steps / 1e6:8.1f} {spent.seconds:6.0f}s "
            f"{spent.cpu:6.0f}s {own:6.1f}s"
        )
    return "\n".join([*lines, "", *_shares(runs, spec)]) + "\n"


def _shares(runs: Runs, spec: TuneSpec) -> list[str]:
    """What the tuner spends until it has found what each rival finds at last, relative to that rival's whole budget."""
    lines = ["the tuner's cost until it is as good as a rival's median end, over that rival's whole cost:"]
    lines.append(f"{'':18}{'loss':>9} {'reached':>8} {'steps':>8} {'wall':>8} {'CPU':>8}")
    shares = {}
    for name in [*rivals(spec), PI]:
        loss = median([run.best[-1] for run in runs[name]])
        shares[name] = [_share(runs, name, loss, column) for column in ("steps", "seconds", "cpu")]
        reached = sum(run.best[-1] <= loss for run in runs[GRADIENT])
        row = "".join(f" {100 * share:7.1f}%" for share in shares[name])
        lines.append(f"{name:18}{loss:9.4f} {reached:>6}/{len(runs[GRADIENT])}{row}")
    name, loss = bar(runs, spec)
    own = [median([run.until(loss, column) for run in runs[name]]) for column in ("steps", "seconds")]
    ours = [median([run.until(loss, column) for run in runs[GRADIENT]]) for column in ("steps", "seconds")]
    verdict = "met" if max(shares[name][:2]) <= BAR else "missed"
    return [
        *lines,
        "",
        f"best rival: {name}, {loss:.4f}; it comes there itself after {own[0] / 1e6:.1f} M steps and {own[1]:.0f} s, "
        f"the tuner after {ours[0] / 1e6:.1f} M steps and {ours[1]:.0f} s",
        f"the bar, at most {BAR:.0%} of its steps and of its wall-clock (aim {AIM:.0%}): {verdict}",
    ]


def _share(runs: Runs, name: str, loss: float, column: str) -> float:
    whole = median([float(run.spent[-1][Spent._fields.index(column)]) for run in runs[name]])
    return median([run.until(loss, column) for run in runs[GRADIENT]]) / whole


def picture(runs: Runs, spec: TuneSpec, path: Path) -> None:
    """How far the best loss so far lies above the least of all, over simulated steps and over wall-clock.

    Every run is a thin line, the median a thick one; whoever began at the spectra's proposals is dashed.
    """
    least = min(run.best[-1] for found in runs.values() for run in found)

    def above(losses: np.ndarray) -> np.ndarray:
        gap: np.ndarray = np.maximum(losses - least, RESOLVED)
        return gap

    with figure(path, 1, 2, size=(10.0, 4.2)) as axes:
        for panel, column, unit in zip(axes, (1, 2), ("simulated steps", "wall-clock [s]"), strict=True):
            for name, found in runs.items():
                if name == TEXTBOOK:
                    panel.axhline(above(found[0].best)[-1], color=COLORS[PI], lw=1.0, ls=":", label=name)
                    continue
                look = {"where": "post", "color": COLORS[name.removesuffix(COARSE)]}
                look["ls"] = "--" if name.endswith(COARSE) else "-"
                for run in found:
                    panel.step(run.spent[:, column], above(run.best), lw=0.4, alpha=0.5, **look)
                at, middle = _median(found, column)
                panel.step(at, above(middle), lw=1.8, label=name, **look)
            panel.axhline(above(np.array(bar(runs, spec)[1])), color="black", lw=0.6, label="best rival's end")
            panel.set_xscale("log")
            panel.xaxis.set_minor_formatter("")
            panel.set_yscale("log")
            panel.set_xlabel(unit)
        axes[0].set_ylabel("best loss so far, above the least of all")
        axes[1].legend(fontsize=7.0)


def _median(found: Sequence[Run], column: int) -> tuple[np.ndarray, np.ndarray]:
    """Median over the runs wherever all have begun; a finished one stays what it is."""
    at = np.unique(np.concatenate([run.spent[:, column] for run in found]))
    at = at[at >= max(run.spent[0, column] for run in found)]
    rows = [run.best[np.searchsorted(run.spent[:, column], at, side="right") - 1] for run in found]
    return at, np.median(rows, axis=0)
