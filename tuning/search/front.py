"""The front of what can be had: the soft goals against the limits of hard ones, such as M_s and effort, in one descent.

Every combination of limits is a start of its own with limits of its own, so the whole front costs one program. Between
the legs of the descent each point takes over the best vector of any other that also holds its limits.
"""

from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import msgspec
import numpy as np

from jaxmpc import described
from jaxmpc.files.alone import alone_in
from jaxmpc.files.errors import InputError, check_type
from jaxmpc.files.sealed import digest, write_atomic
from jaxmpc.metrics import Metrics
from jaxmpc.pictures.figures import figure
from jaxmpc.quantities import METRICS, PARAMETERS
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.precision import in_float64
from tuning.job.goals import GOALS
from tuning.job.space import KNOTS
from tuning.job.spec import MAKE_SPEC, TuneSpec
from tuning.objective.problem import problem_of, training
from tuning.search.optimise import descend, schedule
from tuning.search.run import run_search
from tuning.search.state import FEASIBLE, SearchState

LEGS = 3
"""Descents with an exchange between them."""
SHARE = 0.2
"""Share of the job's steps that a leg takes."""


class Front(NamedTuple):
    """Points of a front, loosest limits first; NaN where nothing was found that holds them."""

    limits: dict[str, np.ndarray]
    """Per goal, (points,)."""
    params: list[Params | None]
    score: np.ndarray
    """Risk of the soft goals in training, (points,) [-]."""
    hard: np.ndarray
    """Reached value of each limited goal, (points, goals), in its unit."""
    cells: Metrics
    """In training, each field (points, stiffness, scenarios, 3)."""

    def __repr__(self) -> str:
        lines = [
            described.Line(name, ", ".join(f"{x:.4g}" for x in limits), described.unit(GOALS[name]), "limits")
            for name, limits in self.limits.items()
        ]
        lines.append(described.Line("score", ", ".join(f"{x:.4g}" for x in self.score), "", "risk of the soft goals"))
        return described.as_text(f"Front of {len(self.score)} points, {sum(map(bool, self.params))} held", lines)


@in_float64
def pareto(
    spec: TuneSpec, folder: str | Path | None = None, progress: bool = False, z: np.ndarray | None = None
) -> Front:
    """The front of a job, for the limits in its table [pareto].

    Args:
        spec: The job.
        folder: Where the states are kept, and where `pareto.csv` and `pareto.png` go; None keeps none.
        progress: Whether to show progress.
        z: Where every point starts, (size,); None tunes the job first.

    Raises:
        InputError: The job is none or has no such limits, the folder is a file or holds the state of another job, or
            another process works in it.
    """
    check_type("spec", spec, TuneSpec, MAKE_SPEC)
    if not spec.pareto:
        raise InputError("pareto", "empty", "a table of limits", "Give some, such as M_s = [1.6, 2.0, 3.0].")
    place = None if folder is None else Path(folder)
    with alone_in(place):
        front = _front(spec, place, progress, z)
        if place is not None:
            write_atomic(place / "pareto.csv", table(front).encode())
            front_figure(front, place / "pareto.png")
    return front


def _front(spec: TuneSpec, place: Path | None, progress: bool, z: np.ndarray | None) -> Front:
    if z is None:
        way = run_search(spec, place, progress)
        spec, z = msgspec.structs.replace(way.spec, pareto=spec.pareto), way.steps[-1].state.leader_z
    # Of a floor the smaller is the looser.
    combined = list(product(*(sorted(values, reverse=GOALS[name].ceiling) for name, values in spec.pareto.items())))
    limits = {name: np.array([row[i] for row in combined]) for i, name in enumerate(spec.pareto)}
    job = msgspec.structs.replace(spec, goals={**spec.goals, **{name: combined[0][i] for i, name in enumerate(limits)}})
    problem = problem_of(job, training(spec, spec.tune.train_seeds)).with_limits(limits)
    goals = [*job.margin_goals, *problem.hard_goals]
    asked = np.stack([limits.get(name, np.full(len(combined), job.held[name])) for name in goals], axis=1)
    floors = np.array([not GOALS[name].ceiling for name in goals])
    starts, key = np.tile(z, (len(combined), 1)), digest({"job": job.digest, "from": z.tolist()})
    for leg in range(LEGS):
        plan = schedule(max(1, round(SHARE * spec.tune.steps)), False, spec.tune.learning_rate * 0.5**leg)
        plan = plan._replace(patience=len(plan.widths))
        state = descend(job, problem, starts, plan, place, f"state-pareto-{leg + 1}.npz", progress, key)
        starts = handed_on(state, asked, floors)
    values = problem.differentiate(starts, 1.0)
    held = values.hard.max(axis=1) <= FEASIBLE
    columns = [goals.index(name) for name in limits]
    reached = np.where(floors, asked / values.hard, values.hard * asked)
    return Front(
        limits,
        [spec.space.exact(row) if ok else None for row, ok in zip(starts, held, strict=True)],
        np.where(held, values.score, np.nan),
        np.where(held[:, None], reached[:, columns], np.nan),
        jax.tree.map(lambda field: np.where(held[:, None, None, None], field, np.nan), values.cells),
    )


def handed_on(state: SearchState, asked: np.ndarray, floors: np.ndarray) -> np.ndarray:
    """Starts of the next leg: per point the best vector of any point that holds its limits, else its closest one.

    Args:
        state: After a leg.
        asked: Limits, (points, goals).
        floors: Which of them are floors, (goals,).
    """
    found = np.isfinite(state.best)
    own = np.where(found[:, None], state.best_z, state.closest_z)
    # Normalised goals of each point's best vector, at the iteration that found it.
    at = [int(np.argmax((state.path[: state.iteration, i] == own[i]).all(axis=1))) for i in range(len(own))]
    normalised = np.stack([state.hard[row, i] for i, row in enumerate(at)])
    for i, limit in enumerate(asked):
        ratio = asked / limit
        fits = found & (np.where(floors, 1.0 / ratio, ratio) * normalised <= FEASIBLE).all(axis=1)
        score = np.where(fits, state.best, np.inf)
        if score.min() < (state.best[i] if found[i] else np.inf):
            own[i] = state.best_z[int(np.argmin(score))]
    return own


def table(front: Front) -> str:
    """The front as CSV."""
    names = [f"limit_{name}" for name in front.limits] + [f"reached_{name}" for name in front.limits]
    metrics = (f"worst_{name} [{row.unit}]" for name, row in METRICS.items())
    most = max((len(params.knots) for params in front.params if params), default=0)
    of_knots = [f"{KNOTS}{i + 1}.{name}" for i in range(most) for name in PARAMETERS]
    lines = [",".join([*names, "score", *metrics, *PARAMETERS, *of_knots])]
    for i, params in enumerate(front.params):
        numbers = [*(values[i] for values in front.limits.values()), *front.hard[i], front.score[i]]
        numbers += [getattr(front.cells, name)[i].max() for name in METRICS]
        owners = [params, *params.knots] if params else []
        found = [owner.numbers.get(name, ()) for owner in owners for name in PARAMETERS]
        entries = [" ".join(f"{x:.6g}" for x in np.ravel(value)) for value in found]
        entries += [""] * (len(PARAMETERS) + len(of_knots) - len(entries))
        lines.append(",".join([*(f"{number:.6g}" for number in numbers), *entries]))
    return "\n".join(lines) + "\n"


def front_figure(front: Front, path: Path) -> None:
    """Score over the first limited goal, a line for each combination of the other limits.

    Args:
        front: What `pareto` returned.
        path: Where the figure goes.
    """
    first, *others = front.limits
    rest = np.stack([front.limits[name] for name in others], axis=1) if others else np.zeros((len(front.score), 0))
    with figure(path, 1, 1, size=(4.5, 3.2)) as panel:
        for row in np.unique(rest, axis=0):
            line = (rest == row).all(axis=1)
            bounds = zip(others, row, strict=True)
            label = ", ".join(f"{name} {GOALS[name].sign} {value:g}" for name, value in bounds)
            panel.plot(front.hard[line, 0], front.score[line], "o-", ms=4, label=label or None)
        panel.set_xlabel(f"{first} [{GOALS[first].unit}]")
        panel.set_ylabel("score of the soft goals")
        if others:
            panel.legend()
