"""Do the levels of the ladder tell good controllers from bad ones alike?"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmpc.xla.precision import in_float64
from tuning.job.settings import Level
from tuning.proof.gradients import values_at
from tuning.proof.result import LOST, TuneResult
from tuning.search.multifidelity import Step

MOST = 24
"""Points compared at most, as many of each step: on the arm each costs as much as a step of a start."""


class Pair(NamedTuple):
    """Two levels; NaN where fewer than three points hold the heart on both."""

    coarse: Level
    fine: Level
    rank: float
    """Spearman's rank correlation of their scores [-]."""
    ratio: float
    """Median of the finer level's worst residual RMS over the coarser one's [-]."""


class Agreement(NamedTuple):
    """The same points on every level."""

    levels: tuple[Level, ...]
    origin: Float[np.ndarray, " points"]
    """The step that found each, from 0."""
    score: Float[np.ndarray, "levels points"]
    """[-]; NaN where the heart is not held."""
    worst: Float[np.ndarray, "levels points"]
    """Largest residual RMS in training [N]; NaN where the heart is not held."""

    @property
    def pairs(self) -> list[Pair]:
        """Every two levels."""
        from scipy.stats import spearmanr

        found = []
        for i, j in combinations(range(len(self.levels)), 2):
            both = np.isfinite(self.score[i]) & np.isfinite(self.score[j])
            rank, ratio = np.nan, np.nan
            if both.sum() >= 3:
                rank = float(spearmanr(self.score[i, both], self.score[j, both]).statistic)
                ratio = float(np.median(self.worst[j, both] / self.worst[i, both]))
            found.append(Pair(self.levels[i], self.levels[j], rank, ratio))
        return found


@in_float64
def agreement(result: TuneResult) -> Agreement | None:
    """Look on every level at the best points that each step has found; None where there is but one level."""
    last: dict[Level, Step] = {step.level: step for step in result.steps}
    if len(last) < 2:
        return None
    points, origin = [], []
    for i, step in enumerate(result.steps):
        state = step.state
        best = np.where(np.isfinite(state.best)[:, None], state.best_z, state.closest_z)
        order = np.lexsort((state.closest, state.best))[: MOST // len(result.steps)]
        points.append(best[order])
        origin += [i] * len(order)
    z, kept = np.unique(np.concatenate(points), axis=0, return_index=True)
    seen = [values_at(step.problem, z, len(step.state.z)) for step in last.values()]
    worst = np.stack([values.worst for values in seen])
    held = worst < LOST
    score = np.where(held, np.stack([values.score for values in seen]), np.nan)
    return Agreement(tuple(last), np.array(origin)[kept], score, np.where(held, worst, np.nan))
