"""The tuner of this package under a stopwatch: its `climb` as it is, every look timed and counted."""

import time
from unittest import mock

import msgspec
import numpy as np

from benchmarks.rivals.objective import LOST
from benchmarks.rivals.record import Clock, Run, Spent
from tuning.ladder import climb
from tuning.objective import Values
from tuning.problem import Problem
from tuning.spec import TuneSpec


def tuned(spec: TuneSpec, cost_ratio: float, rate: float, steps: int) -> Run:
    """Run the tuner once.

    Args:
        spec: The job; its seed draws the random starts.
        cost_ratio: What a look costs per controller, relative to an evaluation [-].
        rate: Simulated steps per second of evaluations: what comes before the first look on the last level steps no
            time there and counts as many steps as its wall-clock is worth.
        steps: Simulated steps of an evaluation.
    """
    spent: list[Spent] = []
    least: list[float] = []
    best = np.inf, np.zeros(0), np.nan, np.inf
    starts, coarse, inside, counted = np.zeros((0, 0)), Spent(), 0.0, 0.0
    clock = Clock()
    original = Problem.look

    def look(problem: Problem, z: np.ndarray, width: float) -> Values:
        nonlocal best, starts, coarse, inside, counted
        last = decides(problem, spec)
        if last and not spent:
            before = clock.spent(0.0, 0.0)
            worth = rate * before.seconds if len(spec.ladder) > 1 else 0.0
            starts, coarse = z, before._replace(steps=worth, evaluations=worth / steps)
        began = time.perf_counter()
        values = original(problem, z, width)
        inside += time.perf_counter() - began
        if last:
            # With soft horizons it is not the loss of a controller that there is.
            losses = np.nan_to_num(values.loss, nan=LOST) if width == 1.0 else np.full(len(z), np.inf)
            i = int(np.argmin(losses))
            if losses[i] < best[0]:
                best = float(losses[i]), z[i], float(values.score[i]), float(values.hard[i].max(initial=0.0))
            counted += cost_ratio * len(z)
            spent.append(clock.spent(coarse.evaluations + counted, coarse.steps + counted * steps))
            least.append(best[0])
        return values

    with mock.patch.object(Problem, "look", look):
        climb(spec)
    own = clock.spent(0.0, 0.0).seconds - inside
    return Run(np.array(spent), np.array(least), *best[1:], own, starts, np.array(coarse))


def decides(problem: Problem, spec: TuneSpec) -> bool:
    """Whether a problem is that of the last level."""
    return problem.data.spectra is None and problem.kind.world.physics == spec.experiment.physics


def warmed_up(spec: TuneSpec) -> float:
    """Compile every program of the tuner, by climbing in as few steps as there can be; seconds that this takes."""
    began = time.perf_counter()
    climb(msgspec.structs.replace(spec, tune=msgspec.structs.replace(spec.tune, steps=1)))
    return time.perf_counter() - began
