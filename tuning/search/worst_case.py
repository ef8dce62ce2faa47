"""The worst-case loop: what is the worst that a tuned controller may meet, and has it been tuned for?"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.metrics import Metrics
from tuning.job.goals import OVERSHOOT, run_goals
from tuning.job.spec import TuneSpec
from tuning.objective.comparison import versus
from tuning.objective.problem import training
from tuning.search.state import SearchState

FIRST_SEED = 1_000_000
"""First seed of the scenarios searched; held-out ones among them are left out."""
NEWS = 0.01
"""How much worse than the worst in training a scenario must be to be worth adding [-]."""


class WorstCase(NamedTuple):
    """The worst scenario of a search."""

    trained: Experiment
    """At the length of a training run."""
    value: float
    """Its largest soft goal [-]."""
    known: float
    """The largest in training [-]."""


def search(spec: TuneSpec, state: SearchState, met: Sequence[Experiment], show: bool = False) -> WorstCase | None:
    """The scenario in which the best controller so far stands worst, if training knows none as bad.

    Args:
        spec: The job.
        state: Holds the best controller.
        met: The scenarios of training.
        show: Whether to show progress.

    Returns:
        The scenario; None if nothing new is worse.
    """
    seeds = [FIRST_SEED + i for i in range(spec.tune.searched)]
    pool = training(spec, [seed for seed in seeds if seed not in spec.tune.heldout_seeds])
    before, (after,) = versus(spec, [spec.space.exact(state.leader_z)], [*met, *pool], show)
    values = standing_of(spec, after, before)
    known, new = float(values[: len(met)].max()), values[len(met) :]
    if new.max() <= known * (1.0 + NEWS):
        return None
    return WorstCase(pool[int(np.argmax(new))], float(new.max()), known)


def standing_of(spec: TuneSpec, after: Metrics, before: Metrics) -> np.ndarray:
    """Largest soft goal of the runs per scenario [-]; ∞ where a run was lost.

    Args:
        spec: The job.
        after: Of the controller to judge, each field (scenarios, stiffness, 3).
        before: Of the controller before tuning, the same.
    """
    asked = {name: limit for name, limit in spec.soft.items() if name != OVERSHOOT} or {"rms": 1.0}
    swapped, reference = jax.tree.map(lambda field: np.swapaxes(field, 0, 1), (after, before))
    goals = run_goals(swapped, reference, None, asked)
    largest: np.ndarray = np.max([np.asarray(goal).max(axis=(0, 2)) for goal in goals.values()], axis=0)
    return np.where(np.isnan(largest), np.inf, largest)
