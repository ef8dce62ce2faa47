"""The way to a controller: a descent from many points; for the arm it is one on spectra, and then the arm runs."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc import margins
from jaxmpc.files.errors import InputError
from jaxmpc.quantities import MARGINS
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.place import wake
from jaxmpc.xla.precision import in_float64
from tuning.job.spec import TuneSpec
from tuning.objective.problem import Problem, problem_of, training
from tuning.search.ahead import Tasks, begin, early, readied, threads
from tuning.search.mapping import PROPOSED, refine, spectra_of
from tuning.search.optimise import descend, rehearse, schedule
from tuning.search.state import SearchState, check_states

SCREENED = 16
"""Random points tried for each start of a descent."""
COARSE = 8
"""Starts on the spectra, for each start of the job."""
SAME = 0.05
"""Starts nearer to each other than this, per unconstrained number, count as one."""


class Step(NamedTuple):
    """A descent, or the rounds of space mapping."""

    name: str
    problem: Problem
    state: SearchState
    spectra: Problem | None = None
    """What proposes between the runs of space mapping, whose iterations have new points each. None is a descent, where
    every start keeps its place."""


class SearchHistory(NamedTuple):
    """Steps of a search, in order."""

    spec: TuneSpec
    """The job, with the disturbance order that won."""
    steps: list[Step]
    """The last one holds the result."""
    orders: dict[int, float]
    """Score of each disturbance order after its descent [-]; ∞ where nothing held the hard goals."""


def run_search(
    spec: TuneSpec,
    folder: Path | None = None,
    show: bool = False,
    after: Callable[[TuneSpec], Tasks] = lambda _: (),
    pool: Executor | None = None,
) -> SearchHistory:
    """Descend from many points; on the arm that is done on spectra, which runs then correct.

    Args:
        spec: The job.
        folder: Where the states are kept, from which the same call continues; None keeps none.
        show: Whether to show progress.
        after: What to do of a job on the arm beside its search, such as compiling what comes after that.
        pool: Threads that do so (`tuning.search.ahead.threads`), and may go on when the search is over; None are its
            own, for which it waits.

    Raises:
        InputError: The fixed gains of a family, which stay, miss a hard goal already; or the folder is of another job.
    """
    jobs = [spec.with_order(order) for order in spec.tune.orders] or [spec]
    for job in jobs:
        _check_fixed(job, job is not spec)
    if folder is not None:
        check_states(folder, [job.digest for job in jobs])
    with threads() if pool is None else nullcontext(pool) as pool:
        pool.submit(wake)

        ahead: list[Future[Problem]] = []

        def described(job: TuneSpec) -> Problem:
            """What the descent descends on; programs compile from when their shapes are known."""

            def begun(problem: Problem) -> None:
                for program in (problem.compile_margins, problem.compile_runs):
                    pool.submit(in_float64(program), _starts(job))
                pool.submit(in_float64(rehearse), _starts(job), job.space.size)
                # Of several, nobody knows which will win.
                if job.on_arm and len(jobs) == 1:
                    ahead.append(readied(job, problem, pool, after))

            met = training(job, job.tune.train_seeds)
            return problem_of(job, met, spectral=job.on_arm, begun=begun)

        problems = [*map(described, jobs)]
        each = [*zip(jobs, problems, strict=True)]
        starts = [screened(job, problem, _starts(job), show) for job, problem in each]
        if ahead and not early():
            begin(jobs[0], after, pool)
        firsts = [proposal(job, problem, z, folder, show) for (job, problem), z in zip(each, starts, strict=True)]
        orders = {
            int(job.params.disturbance_order): float(one.state.best.min())
            for job, one in zip(jobs, firsts, strict=True)
        }
        # Where none holds the hard goals, the one that came closest.
        reached = [(one.state.best.min(), one.state.closest.min()) for one in firsts]
        best = reached.index(min(reached))
        job, steps = jobs[best], [firsts[best]]
        if job.on_arm:
            if not ahead:
                ahead.append(readied(job, problems[best], pool, after))
                if not early():
                    begin(job, after, pool)
            runs = ahead[0].result()
            spectra = spectra_of(job, problems[best], runs.data.reference)
            z = proposed(job, steps[0].state, PROPOSED * job.tune.starts)
            state = refine(job, runs, spectra, z, folder, _file("mapping", job), show)
            steps.append(Step("mapping", runs, state, spectra))
    return SearchHistory(job, steps, orders)


def proposal(spec: TuneSpec, problem: Problem, z: np.ndarray, folder: Path | None, show: bool) -> Step:
    """The descent: from some starts, horizons first soft."""
    soft = bool(spec.space.whole.any())
    plan = schedule(spec.tune.steps, soft, spec.tune.learning_rate)
    name, file = ("spectra", "spectra") if spec.on_arm else ("linear", "")
    return Step(name, problem, descend(spec, problem, z, plan, folder, _file(file, spec), show))


def screened(spec: TuneSpec, problem: Problem, count: int, show: bool) -> np.ndarray:
    """The given parameters first, then the most promising of many random ones: there is more than one valley."""
    space = spec.space
    drawn = space.draw(SCREENED * count, spec.tune.seed)
    losses = []
    # That of the margins, which takes longer, is compiling beside.
    problem.compile_runs(count)
    with progress("screen", len(drawn), "points", show) as tick:
        for part in np.split(drawn, SCREENED):
            losses.append(problem.differentiate(part, 1.0).loss)
            tick(count * len(losses), "")
    order = np.argsort(np.concatenate(losses), stable=True)
    return np.concatenate([space.encode(space.base)[None], drawn[order[: count - 1]]])


def proposed(spec: TuneSpec, state: SearchState, count: int) -> np.ndarray:
    """Points to run first: the given parameters, and the best that differ, by score and then by goals.

    Where there are fewer, those between the best ones fill up.
    """
    reached = np.isfinite(state.best)
    vectors = np.where(reached[:, None], state.best_z, state.closest_z)
    order = np.lexsort((state.closest, state.best))
    chosen = [spec.space.encode(spec.space.base)]
    for z in vectors[order]:
        if len(chosen) < count and all(np.abs(z - other).mean() > SAME for other in chosen):
            chosen.append(z)
    for i in range(count - len(chosen)):
        share = (i + 1) / (count - len(chosen) + 1)
        chosen.append((1.0 - share) * vectors[order[0]] + share * vectors[order[min(1, len(order) - 1)]])
    return np.stack(chosen)


def _check_fixed(spec: TuneSpec, of_another_order: bool) -> None:
    """Refuse to tune knots beside fixed gains that miss a goal and cannot move, of another order than given too."""
    if not spec.fixed_stay:
        return
    found = margins(spec.params, spec.judged_at, path=spec.experiment.loop_path(spec.ideal))
    for name, limit in spec.margin_goals.items():
        goal, values = MARGINS[name], np.asarray(getattr(found, name))
        if not goal.kept(values, limit).all():
            K_s = spec.judged_at[int((np.argmax if goal.ceiling else np.argmin)(values))]
            value = f"{name} = {goal.worst(values):.4g} at {K_s:.4g} N/m"
            if of_another_order:
                key = f"tune.orders, of {spec.params.disturbance_order}"
                remedy = "They are designed with that order and then stay: leave it out, or free them, too."
            else:
                key = "params"
                remedy = 'They stay as they are: tune them by themselves first, or take published = "cautious".'
            raise InputError(key, value, f"{goal.sign} {goal.amount(limit)} with its fixed gains", remedy)


def _starts(spec: TuneSpec) -> int:
    """How many descend."""
    return COARSE * spec.tune.starts if spec.on_arm else spec.tune.starts


def _file(name: str, spec: TuneSpec) -> str:
    order = f"order-{spec.params.disturbance_order}" if len(spec.tune.orders) > 1 else ""
    return "-".join(["state", *filter(None, (name, order))]) + ".npz"
