"""Tuners that only see the value of the objective, each asked for a batch at a time."""

import time
import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from cmaes import CMA
from jaxtyping import Float

from benchmarks.rivals.objective import BATCH, ObjectiveValues
from benchmarks.rivals.record import Clock, Run
from benchmarks.rivals.room import shares, vectors
from tuning.job.space import EDGE, FreeParameter

Points = Float[np.ndarray, "n size"]
Losses = Float[np.ndarray, " n"]


class Tuner(Protocol):
    """Points are shares of the room, from 0 to 1 on each axis."""

    def begin(self, points: Points, losses: Losses) -> None:
        """Take what the given starts are worth."""

    def ask(self) -> Points:
        """`BATCH` points to evaluate."""

    def tell(self, losses: Losses) -> None:
        """Their losses."""


class Random:
    """Uniform in the room."""

    def __init__(self, size: int, seed: int) -> None:
        self._size, self._random = size, np.random.default_rng(seed)

    def begin(self, points: Points, losses: Losses) -> None:
        pass

    def ask(self) -> Points:
        return self._random.uniform(EDGE, 1.0 - EDGE, (BATCH, self._size))

    def tell(self, losses: Losses) -> None:
        pass


class CmaEs:
    """CMA-ES by the library that Optuna's sampler wraps, begun at the best start; once converged, begun elsewhere.

    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772.
    """

    WIDE, NARROW = 1.0 / 6.0, 0.05
    """First step size from a start that is only given, as Optuna's, and from one that was proposed [-]."""

    def __init__(self, size: int, seed: int) -> None:
        self._size, self._seed = size, seed
        self._random = np.random.default_rng(seed)
        self._asked: Any = None

    def begin(self, points: Points, losses: Losses) -> None:
        self._restart(points[np.argmin(losses)], self.WIDE if len(points) == 1 else self.NARROW)

    def ask(self) -> Points:
        self._asked = np.stack([self._strategy.ask() for _ in range(BATCH)])
        return np.asarray(self._asked)

    def tell(self, losses: Losses) -> None:
        self._strategy.tell(list(zip(self._asked, losses.tolist(), strict=True)))
        if self._strategy.should_stop():
            self._restart(self._random.uniform(EDGE, 1.0 - EDGE, self._size), self.WIDE)

    def _restart(self, mean: np.ndarray, sigma: float) -> None:
        bounds = np.tile([0.0, 1.0], (self._size, 1))
        seed = int(self._random.integers(2**31))
        self._strategy = CMA(mean=mean, sigma=sigma, bounds=bounds, population_size=BATCH, seed=seed)


class Tpe:
    """Optuna's tree-structured Parzen estimator, multivariate, its pending points counted as bad ones.

    S. Watanabe, "Tree-structured Parzen estimator", arXiv:2304.11127; Akiba et al., "Optuna", KDD 2019.
    """

    def __init__(self, size: int, seed: int) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
        self._room: dict[str, Any] = {f"{i}": optuna.distributions.FloatDistribution(0.0, 1.0) for i in range(size)}
        self._study = optuna.create_study(sampler=sampler)
        self._new = optuna.trial.create_trial
        self._asked: list[Any] = []

    def begin(self, points: Points, losses: Losses) -> None:
        for point, loss in zip(points, losses.tolist(), strict=True):
            named = {f"{i}": float(share) for i, share in enumerate(point)}
            self._study.add_trial(self._new(params=named, distributions=self._room, value=loss))

    def ask(self) -> Points:
        self._asked = [self._study.ask(self._room) for _ in range(BATCH)]
        return np.array([list(trial.params.values()) for trial in self._asked])

    def tell(self, losses: Losses) -> None:
        for trial, loss in zip(self._asked, losses.tolist(), strict=True):
            self._study.tell(trial, loss)


TUNERS: dict[str, Callable[[int, int], Tuner]] = {"random": Random, "TPE": Tpe, "CMA-ES": CmaEs}


def search(
    tuner: Tuner,
    axes: tuple[FreeParameter, ...],
    evaluate: Callable[[np.ndarray], ObjectiveValues],
    starts: np.ndarray,
    budget: int,
    steps: int,
    clock: Clock,
) -> Run:
    """Run a tuner to the end of its budget.

    Args:
        tuner: The tuner, new.
        axes: Of the room.
        evaluate: The objective.
        starts: Unconstrained vectors that it is given, (starts, size); their evaluations count.
        budget: Evaluations.
        steps: Simulated steps of one.
        clock: Begun when the run began.
    """
    spent, least, own, done = [], [], 0.0, 0
    left = time.perf_counter()
    best = (np.inf, starts[0], np.nan, np.inf)
    while done < budget:
        z = vectors(axes, tuner.ask())[: budget - done] if done else starts
        began = time.perf_counter()
        seen = evaluate(z)
        own, left = own + began - left, time.perf_counter()
        i = int(np.argmin(seen.loss))
        if seen.loss[i] < best[0]:
            best = float(seen.loss[i]), z[i], float(seen.score[i]), float(seen.hard[i])
        done += len(z)
        if done == len(z):
            tuner.begin(shares(axes, starts), seen.loss)
        elif len(z) == BATCH:
            tuner.tell(seen.loss)
        spent.append(clock.spent(done, done * steps))
        least.append(best[0])
    return Run(np.array(spent), np.array(least), *best[1:], own)
