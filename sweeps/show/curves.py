"""Curves of the rows of a sweep that matter: which they are, and their loops and forces, computed anew."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.files.toml import toml_text
from jaxmpc.quantities import HIGHEST_M_S
from jaxmpc.report.content import Chart, Detail, Series
from jaxmpc.report.thinning import thinned
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params, by_structure
from sweeps.met import met
from sweeps.result import Result
from sweeps.show.candidates import template

PLOTTED, PLOTTED_ON_ARM = 12, 3
"""Rows of which curves are computed: the best, then the front."""
WINDOW = 6.0
"""Length of the end of a run that is kept of their forces [s]."""


def that_matter(result: Result, max_M_s: float | None) -> list[int]:
    """Places of the rows whose curves are worth computing: half of them the best, the others along the front."""
    most = PLOTTED if result.plan.canonical["experiment"]["physics"] == "linear" else PLOTTED_ON_ARM
    best = result.best(-(-most // 2), max_M_s)["row"].tolist()
    front = result.pareto()["row"]
    even = front[np.unique(np.linspace(0, len(front) - 1, most).round().astype(int))].tolist() if len(front) else []
    chosen = list(dict.fromkeys([*best, *even]))[:most]
    return [int(np.flatnonzero(result["row"] == row)[0]) for row in chosen]


def world_words(result: Result) -> str:
    """What the rows of a sweep ran on, in words."""
    swept = (axis.values for axis in result.axes if axis.name == "physics")
    physics = next(swept, (result.plan.canonical["experiment"]["physics"],))
    return " and ".join(dict.fromkeys(map(_loop_words, physics)))


def length_words(result: Result) -> str:
    """How long the rows of a sweep ran, one at least, in words."""
    lengths = met(result.plan, result.columns, "duration")
    shortest, longest = lengths.min(), lengths.max()
    return f"{shortest:g} s" if shortest == longest else f"{shortest:g} to {longest:g} s"


def _longest(result: Result) -> float:
    """Length of the longest run [s]."""
    return float(met(result.plan, result.columns, "duration").max())


def _loop_words(physics: str) -> str:
    return "linear loop" if physics == "linear" else "arm"


def note(result: Result, count: int) -> str:
    """What is kept of which rows, for a reader who looks for the curves of another."""
    return (
        f"the {count} best rows and rows of the front, recomputed on the {world_words(result)}: the last "
        f"{min(WINDOW, _longest(result)):g} s of the residual on each axis, |S|, Nyquist, Bode of L and a step."
    )


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
                f"residual force on the {_loop_words(experiment.physics)}, {axis.upper()}",
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
