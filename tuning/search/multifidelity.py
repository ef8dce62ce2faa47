"""The way up: coarse levels propose starts, the experiment's physics decides, and the worst it may meet is added."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.quantities import HORIZONS
from jaxmpc.terminal.progress import progress
from tuning.job.settings import Level
from tuning.job.spec import TuneSpec
from tuning.objective.problem import Problem, problem_of, training
from tuning.search.mapping import PROPOSED, refine
from tuning.search.optimise import descend, schedule
from tuning.search.state import SearchState
from tuning.search.worst_case import WorstCase, search

SCREENED = 16
"""Random points tried for each start of the first level."""
COARSE = 8
"""Starts of a level that only proposes, for each start of the last one."""
BETWEEN, LAST, ROUND = 0.1, 0.1, 0.1
"""Shares of the steps that the levels between take, the last of several levels, and a worst-case round."""
LATER_RATE = 0.03
"""Learning rate of all that begins at good points, relative to the first level's."""
SAME = 0.05
"""Starts nearer to each other than this, per unconstrained number, count as one."""


class Step(NamedTuple):
    """What one level, or one round on the last level, found."""

    name: str
    level: Level
    problem: Problem
    state: SearchState
    added: WorstCase | None = None
    """The scenario that this round added."""
    descent: bool = True
    """Whether a start keeps its place from iteration to iteration; with space mapping each iteration has new points."""


class LevelHistory(NamedTuple):
    """The way up."""

    spec: TuneSpec
    """The job, with the disturbance order that won."""
    steps: list[Step]
    """The last one holds the result."""
    orders: dict[int, float]
    """Score of each disturbance order on the first level [-]; ∞ where nothing held the hard goals."""


def run_levels(spec: TuneSpec, folder: Path | None = None, show: bool = False) -> LevelHistory:
    """Tune on every level in turn, then against the worst scenarios that can be found.

    Args:
        spec: The job.
        folder: Where the states are kept, from which the same call continues; None keeps none.
        show: Whether to show progress.
    """
    jobs = [spec.with_order(order) for order in spec.tune.orders] or [spec]
    firsts = [proposal(job, folder, show) for job in jobs]
    orders = {
        int(job.params.disturbance_order): float(one.state.best.min()) for job, one in zip(jobs, firsts, strict=True)
    }
    best = int(np.argmin(list(orders.values())))
    job, steps = jobs[best], [firsts[best]]
    for level in job.ladder[1:]:
        last = level == job.ladder[-1]
        met = _met(job, spare=last)
        problem = problem_of(job, level, met)
        if last and mapped(job):
            z = proposed(job, steps[-1].state, PROPOSED * job.tune.starts)
            state = refine(job, problem, met, z, folder, _file("mapping", job), show)
            steps.append(Step("mapping", level, problem, state, descent=False))
        z = proposed(job, steps[-1].state, job.tune.starts if last else COARSE * job.tune.starts)
        share = LAST if last else BETWEEN
        plan = schedule(max(1, round(share * job.tune.steps)), False, LATER_RATE * job.tune.learning_rate)
        steps.append(Step(level, level, problem, descend(job, problem, z, plan, folder, _file(level, job), show)))
    met = _met(job, spare=True)
    for i in range(job.tune.rounds):
        found = search(job, steps[-1].state, met, show)
        if found is None:
            break
        met[len(job.tune.train_seeds) + i] = found.trained
        problem = problem_of(job, job.ladder[-1], met)
        file = _file(f"round-{i + 1}", job)
        if mapped(job):
            z = proposed(job, steps[-1].state, PROPOSED * job.tune.starts)
            state = refine(job, problem, met, z, folder, file, show)
        else:
            plan = schedule(max(1, round(ROUND * job.tune.steps)), False, LATER_RATE * job.tune.learning_rate)
            z = proposed(job, steps[-1].state, job.tune.starts)
            state = descend(job, problem, z, plan, folder, file, show)
        steps.append(Step(f"round {i + 1}", job.ladder[-1], problem, state, found, not mapped(job)))
    return LevelHistory(job, steps, orders)


def mapped(spec: TuneSpec) -> bool:
    """Whether spectra, which the linear world does without, propose to the last level."""
    return spec.ladder[0] == "frequency" and spec.ladder[-1] == "arm" and spec.tune.mapping > 0


def proposal(spec: TuneSpec, folder: Path | None, show: bool) -> Step:
    """The first level: from the given parameters and from random ones, horizons first soft."""
    level, only = spec.ladder[0], len(spec.ladder) == 1
    problem = problem_of(spec, level, _met(spec, spare=only))
    z = screened(spec, problem, spec.tune.starts if only else COARSE * spec.tune.starts, show)
    soft = any(axis.name in HORIZONS for axis in spec.space.axes)
    plan = schedule(spec.tune.steps, soft, spec.tune.learning_rate)
    return Step(
        level, level, problem, descend(spec, problem, z, plan, folder, _file("" if only else level, spec), show)
    )


def _met(spec: TuneSpec, spare: bool) -> list[Experiment]:
    """The scenarios of training; a place per round is kept free, so that one program serves them all."""
    seeds = spec.tune.train_seeds
    places = spec.tune.rounds if spare else 0
    return training(spec, [*seeds, *(seeds[i % len(seeds)] for i in range(places))])


def screened(spec: TuneSpec, problem: Problem, count: int, show: bool) -> np.ndarray:
    """The given parameters first, then the most promising of many random ones: there is more than one valley."""
    space = spec.space
    drawn = space.draw(SCREENED * count, spec.tune.seed)
    losses = []
    with progress("screen", len(drawn), "points", show) as tick:
        for part in np.split(drawn, SCREENED):
            losses.append(problem.differentiate(part, 1.0).loss)
            tick(count * len(losses), "")
    order = np.argsort(np.concatenate(losses), stable=True)
    return np.concatenate([space.encode(spec.params)[None], drawn[order[: count - 1]]])


def proposed(spec: TuneSpec, state: SearchState, count: int) -> np.ndarray:
    """Starts for the next level: the given parameters, and the best that differ, by score and then by goals.

    Where there are fewer, those between the best ones fill up.
    """
    reached = np.isfinite(state.best)
    vectors = np.where(reached[:, None], state.best_z, state.closest_z)
    order = np.lexsort((state.closest, state.best))
    chosen = [spec.space.encode(spec.params)]
    for z in vectors[order]:
        if len(chosen) < count and all(np.abs(z - other).mean() > SAME for other in chosen):
            chosen.append(z)
    for i in range(count - len(chosen)):
        share = (i + 1) / (count - len(chosen) + 1)
        chosen.append((1.0 - share) * vectors[order[0]] + share * vectors[order[min(1, len(order) - 1)]])
    return np.stack(chosen)


def _file(name: str, spec: TuneSpec) -> str:
    order = f"order-{spec.params.disturbance_order}" if len(spec.tune.orders) > 1 else ""
    return "-".join(["state", *filter(None, (name, order))]) + ".npz"
