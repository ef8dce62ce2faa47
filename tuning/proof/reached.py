"""What a tuning run reached, goal by goal, on scenarios that it has not seen."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmpc.metrics import Metrics
from jaxmpc.report.loops import curves
from jaxmpc.xla.precision import in_float64
from tuning.job.goals import GOALS, OVERSHOOT, RATIO, RUN_GOALS, run_goals
from tuning.proof.result import LOST, TuneResult

STUDY = "a study without the robot's limits, not a controller for a robot"


class Row(NamedTuple):
    """One goal; index 0 is before, 1 after."""

    name: str
    hard: bool
    limit: float
    reached: tuple[float, float]
    """Worst over tissues, and of the runs over held-out scenarios; NaN where unstable."""
    at: float | None
    """Where the tuned controller stands worst [N/m]."""
    implied: bool = False
    """Whether freezing for a robot implies it, and the job leaves it out."""
    beside_lost: tuple[float, ...] = ()
    """Tissues on which a ratio is met by whatever lasts, since the controller before was lost there [N/m]."""

    @property
    def kind(self) -> str:
        """Hard, soft, or held because freezing for a robot implies it."""
        return ("implied" if self.implied else "hard") if self.hard else "soft"

    @property
    def met(self) -> bool:
        """Whether the tuned controller holds it."""
        return bool(GOALS[self.name].kept(self.reached[1], self.limit))

    @property
    def said(self) -> str:
        """Whether it is met, and where only beside one that was lost."""
        return ("yes" if self.met else "no") + (f" ({_lost_on(self.beside_lost)})" if self.beside_lost else "")

    @property
    def text(self) -> str:
        """Name, limit and unit."""
        goal = GOALS[self.name]
        return f"{self.name} {goal.sign} {goal.amount(self.limit)}"


def kept(result: TuneResult) -> np.ndarray:
    """Held-out scenarios that count, (scenarios,): those that the controller before held; if it held none, all."""
    held: np.ndarray = result.held[0]
    return held if held.any() else np.ones_like(held)


@in_float64
def rows(result: TuneResult) -> list[Row]:
    """All goals, the hard ones first."""
    spec = result.spec
    found = []
    both = [result.judged(which) for which in range(2)]
    for name, limit in spec.margin_goals.items():
        # A margin of an unstable loop is no number, its M_s ∞.
        before, after = (np.asarray(getattr(judged.margins, name)) for judged in both)
        worst = float(GOALS[name].worst(before)), float(GOALS[name].worst(after))
        place = (np.argmax if GOALS[name].ceiling else np.argmin)(after)
        found.append(Row(name, True, limit, worst, float(both[1].stiffness[place]), name in spec.implied))
    limits = [(name, limit, True) for name, limit in spec.hard_goals.items()]
    limits += [(name, limit, False) for name, limit in spec.soft.items()]
    overshoot: Any = (np.nan, np.nan)
    if any(name == OVERSHOOT for name, _, _ in limits):
        overshoot = [curves(params, spec.experiment, spec.ideal).overshoot for params in (spec.before, result.params)]
    for name, limit, hard in limits:
        # Beside one that was lost, whatever lasts is better; but a goal in its own unit is a goal there too.
        beside = name in RUN_GOALS and RUN_GOALS[name].part == RATIO
        counted = kept(result) if beside else np.full(len(result.held[0]), True)
        cells = [_cells(result, which, counted) for which in (0, 1)]
        pair = [run_goals(each, cells[0], overshoot[i], {name: 1.0})[name] for i, each in enumerate(cells)]
        per_tissue = np.max(np.asarray(pair[1]), axis=(1, 2))
        largest = [float(np.max(np.asarray(values))) for values in pair]
        stiffness = spec.experiment.stiffness
        K_s = stiffness[int(np.argmax(per_tissue))]
        lost = ~np.all(np.asarray(cells[0].peak_error) < LOST, axis=(1, 2)) & beside
        where = tuple(K for K, one in zip(stiffness, lost, strict=True) if one)
        found.append(Row(name, hard, limit, (largest[0], largest[1]), K_s, hard and name in spec.implied, where))
    return found


def verdict(result: TuneResult) -> str:
    """Which goal is missed and by how much, or that all are met, on held-out scenarios too, beside what and by what."""
    if unmet := result.unmet():
        return unmet
    goals = rows(result)
    missed = [row.text for row in goals if row.hard and not row.met]
    if lost := [
        str(seed) for seed, held in zip(result.spec.tune.heldout_seeds, result.held[1], strict=True) if not held
    ]:
        missed.append(f"|e| < {LOST:g} N in scenario {', '.join(lost)}")
    found = "all hard goals are met" + (f" in training; held out, missed: {', '.join(missed)}" if missed else "")
    if where := next((row.beside_lost for row in goals if row.beside_lost), ()):
        found += f" ({_lost_on(where)}: whatever lasts has met ratios there)"
    if result.spec.experiment.physics == "linear":
        return found
    return found + ("; freeze accepts it" if result.spec.experiment.limited else f"; {STUDY}")


def _lost_on(tissues: tuple[float, ...]) -> str:
    return f"baseline lost on {', '.join(f'{K_s:g}' for K_s in tissues)} N/m"


def _cells(result: TuneResult, which: int, counted: np.ndarray) -> Metrics:
    """Select one controller's metrics in the scenarios that count, each field (stiffness, scenarios, 3)."""
    cells: Metrics = jax.tree.map(lambda field: np.swapaxes(field[which][counted], 0, 1), result.heldout)
    return cells
