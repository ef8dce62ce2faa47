"""The tuner of this package under a stopwatch: its `run_search` as it is, every look timed and counted."""

import time
from collections.abc import Callable
from unittest import mock

import msgspec
import numpy as np

from benchmarks.rivals.objective import LOST
from benchmarks.rivals.record import Clock, Run, Spent
from tuning.job.spec import TuneSpec
from tuning.objective.loss import Values
from tuning.objective.problem import Problem
from tuning.search.run import run_search


def tuned(spec: TuneSpec, cost_ratio: float, rate: float, steps: int) -> Run:
    """Run the tuner once.

    Args:
        spec: The job; its seed draws the random starts.
        cost_ratio: What a look with its gradient costs per controller, relative to an evaluation [-].
        rate: Simulated steps per second of evaluations: whatever the tuner does but run controllers steps no time
            there, and counts as many steps as its wall-clock is worth.
        steps: Simulated steps of an evaluation.
    """
    spent: list[Spent] = []
    least: list[float] = []
    best = np.inf, np.zeros(0), np.nan, np.inf
    starts, coarse, inside, running, counted = np.zeros((0, 0)), Spent(), 0.0, 0.0, 0.0
    clock = Clock()

    def so_far() -> Spent:
        worth = rate * max(clock.spent(0.0, 0.0).seconds - running, 0.0) / steps if spec.on_arm else 0.0
        return clock.spent(counted + worth, (counted + worth) * steps)

    def timed(original: Callable[..., Values], price: float) -> Callable[..., Values]:
        def look(problem: Problem, z: np.ndarray, width: float = 1.0) -> Values:
            nonlocal best, starts, coarse, inside, running, counted
            last = decides(problem, spec)
            if last and not spent:
                starts, coarse = z, so_far()
            began = time.perf_counter()
            values = original(problem, z, width)
            took = time.perf_counter() - began
            inside += took
            if last:
                # With soft horizons it is not the loss of a controller that there is.
                losses = np.nan_to_num(values.loss, nan=LOST) if width == 1.0 else np.full(len(z), np.inf)
                i = int(np.argmin(losses))
                if losses[i] < best[0]:
                    best = float(losses[i]), z[i], float(values.score[i]), float(values.hard[i].max(initial=0.0))
                running += took
                counted += price * len(z)
                spent.append(so_far())
                least.append(best[0])
            return values

        return look

    def evaluated(problem: Problem, z: np.ndarray, _: float) -> Values:
        return evaluate(problem, z)

    evaluate = Problem.evaluate
    with (
        mock.patch.object(Problem, "differentiate", timed(Problem.differentiate, cost_ratio)),
        mock.patch.object(Problem, "evaluate", timed(evaluated, 1.0)),
    ):
        run_search(spec)
    own = clock.spent(0.0, 0.0).seconds - inside
    return Run(np.array(spent), np.array(least), *best[1:], own, starts, np.array(coarse))


def decides(problem: Problem, spec: TuneSpec) -> bool:
    """Whether a problem is the one by runs."""
    return problem.data.spectra is None and (problem.structure.world.robot is None) == (
        spec.experiment.physics == "linear"
    )


def warmed_up(spec: TuneSpec) -> float:
    """Compile every program of the tuner, by climbing in as few steps as there can be; seconds that this takes."""
    began = time.perf_counter()
    few = {"steps": 1, **({"mapping": 2} if spec.on_arm else {})}
    run_search(msgspec.structs.replace(spec, tune=msgspec.structs.replace(spec.tune, **few)))
    return time.perf_counter() - began
