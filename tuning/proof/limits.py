r"""What keeps the tuned controller from being better: active goals and their prices.

At a constrained minimum of the log score f with active goals log gᵢ ≤ 0 there are multipliers λᵢ ≥ 0 with

    ∇f + Σ λᵢ ∇log gᵢ = 0;   a limit relaxed by the factor 1 + r changes the score by (1 + r)^−λᵢ, to first order.

The tuner stops near such a point, not on it, so the λᵢ are those of the least squares.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmpc.xla.precision import in_float64
from tuning.job.goals import margin_goals
from tuning.proof.found import FoundController, place_of
from tuning.proof.gradients import SCORE, Slope, judged_on, on_tissue, sloped, slopes
from tuning.proof.sensitivities import vector_of

ACTIVE = 0.97
"""Normalised goals above this hold the controller back [-]."""
RELAXED = 0.10
"""By how much a limit is relaxed in thought."""


class Active(NamedTuple):
    """A hard goal that is active."""

    goal: str
    stiffness: float | None
    """Where, a local maximum over the tissues [N/m]; None for a goal of the runs."""
    normalised: float
    """[-]"""
    multiplier: float
    """λ [-]; NaN without a feasible point."""
    believed: float = np.nan
    """K̂ that a family holds [N/m]; NaN for fixed gains and goals of the runs."""

    @property
    def place(self) -> str:
        """Where; "" for a goal of the runs."""
        return "" if self.stiffness is None else place_of(self.stiffness, self.believed)

    @property
    def gain(self) -> float:
        """How far the score would fall if this limit alone were relaxed by `RELAXED` [-]."""
        return float(1.0 - (1.0 + RELAXED) ** -self.multiplier)


class LimitStudy(NamedTuple):
    """What holds the tuned controller back."""

    active: list[Active]
    unexplained: float
    """Share of the score's slope that no active goal holds against, of its length [-]: what tuning on could use, or
    what the kinks of a worst case hide."""


@in_float64
def limits(result: FoundController) -> LimitStudy:
    """Active goals of the tuned controller, with multipliers from exact gradients."""
    z, starts = vector_of(result), len(result.state.z)
    problem = sloped(result, z)
    runs = slopes(problem, z, starts)
    held: list[tuple[Active, Slope]] = []
    for goal in active_margins(result):
        assert goal.stiffness is not None
        held.append((goal, slopes(judged_on(problem, goal.stiffness, goal.believed), z, starts)[goal.goal]))
    # What a family does on each tissue is held by itself.
    alone: dict[float | None, dict[str, Slope]] = {None: runs}
    if problem.data.believed is not None:
        alone = {K: slopes(on_tissue(problem, i), z, starts) for i, K in enumerate(result.tissues)}
    for K_s, found in alone.items():
        for name in problem.hard_goals:
            if found[name].value > ACTIVE:
                held.append((Active(name, K_s, found[name].value, np.nan), found[name]))
    goals, downhill = [goal for goal, _ in held], -runs[SCORE].gradient
    if not result.feasible or not np.isfinite(runs[SCORE].value):
        return LimitStudy(goals, np.nan)
    multipliers, left = multipliers_of(downhill, [slope.gradient for _, slope in held])
    priced = [goal._replace(multiplier=float(price)) for goal, price in zip(goals, multipliers, strict=True)]
    return LimitStudy(priced, left / max(float(np.linalg.norm(downhill)), 1e-300))


def active_margins(result: FoundController) -> list[Active]:
    """The tuned controller's active margins but for multipliers, each a local maximum over the stiffness.

    Of a family with the stiffness known it is the worst of the band; fixed gains that stay are left out.
    """
    judged, limits = result.judged(1), result.spec.margin_goals
    fixed = np.isnan(judged.believed)
    groups = [] if result.spec.fixed_stay else [np.flatnonzero(fixed)[:, None]]
    if not fixed.all():
        groups.append(np.flatnonzero(~fixed).reshape(len(np.unique(judged.believed[~fixed])), -1))
    found = []
    for name, row in zip(limits, np.asarray(margin_goals(judged.margins, limits).normalised), strict=True):
        for cells in groups:
            worst = cells[np.arange(len(cells)), np.argmax(row[cells], axis=1)]
            padded = np.concatenate([[-np.inf], row[worst], [-np.inf]])
            peaks = (row[worst] > ACTIVE) & (row[worst] >= padded[:-2]) & (row[worst] > padded[2:])
            found += [
                Active(name, float(judged.stiffness[i]), float(row[i]), np.nan, float(judged.believed[i]))
                for i in worst[peaks]
            ]
    return found


def multipliers_of(
    downhill: Float[np.ndarray, " size"], gradients: Sequence[Float[np.ndarray, " size"]]
) -> tuple[Float[np.ndarray, " goals"], float]:
    """Multipliers λ ≥ 0 that bring −∇f − Σ λᵢ ∇log gᵢ closest to zero, and the length that is left.

    Args:
        downhill: −∇f.
        gradients: ∇log gᵢ of every active goal.
    """
    from scipy.optimize import nnls

    if not gradients:
        return np.zeros(0), float(np.linalg.norm(downhill))
    multipliers, left = nnls(np.stack(gradients, axis=1), downhill)
    return multipliers, float(left)
