"""What a tuning run found, proven on scenarios that it has not seen."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeVar

import jax
import numpy as np

from jaxmpc import described
from jaxmpc.beside import Beside
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.precision import in_float64
from tuning.job.goals import GOALS, OVERSHOOT, margin_goals
from tuning.job.scenarios import scenarios
from tuning.job.spec import TuneSpec
from tuning.objective.comparison import missed_by, standing_of, versus
from tuning.proof.flyable import refusal
from tuning.proof.found import FoundController, found_of
from tuning.search.run import SearchHistory
from tuning.search.state import FEASIBLE, SearchState

T = TypeVar("T")
LOST = 2.0
"""A residual beyond this means that a controller did not hold the heart [N] (`definitions.md`)."""


@dataclass(frozen=True)
class TuneResult(FoundController):
    """Before and after, and the search between. Index 0 is the controller before, 1 the tuned one."""

    heldout: Metrics
    """On the held-out scenarios, each field (2, scenarios, stiffness, 3); NaN where a run was lost."""
    refused: str = ""
    """Why freezing refuses it; "" where it accepts, and for jobs that are not for a robot."""

    def __repr__(self) -> str:
        return described.as_text(*self._told())

    def _repr_html_(self) -> str:
        return described.as_html(*self._told())

    def _told(self) -> tuple[str, list[described.Line]]:
        """Title and lines: what was reached, before → after, and the controller that did."""
        rows = {name: self.worst_of(name) for name in ("rms", "true_rms", "peak_error", "chatter")}
        found = self.margins["ideal" if self.spec.ideal else "as run"]
        rows |= {name: tuple(row.worst(np.asarray(getattr(found, name)), axis=1)) for name, row in MARGINS.items()}
        quantities = {**METRICS, **MARGINS}
        lines = [
            described.Line(name, f"{before:.4g} → {after:.4g}", described.unit(quantities[name]), "worst, held out")
            for name, (before, after) in rows.items()
        ]
        title = "TuneResult, " + ("every goal met" if self.met else self.unmet())
        return title, [*lines, *described.parameters(self.params)[1]]

    @property
    def met(self) -> bool:
        """Whether it holds every hard goal, to the proof as to the search, and freezing accepts it for a robot."""
        return self.feasible and not self.refused and self.proven

    @property
    def held(self) -> np.ndarray:
        """Whether a controller held the heart, (2, scenarios): everything finite and no residual above 2 N."""
        worst: np.ndarray = np.max(self.heldout.peak_error, axis=(2, 3))
        return worst < LOST

    @property
    def worst(self) -> tuple[float, float]:
        """Worst held-out residual RMS over scenario, stiffness and axis, before and after; NaN where unstable [N]."""
        return self.worst_of("rms")

    def worst_of(self, metric: str) -> tuple[float, float]:
        """The same of any metric."""
        before, after = map(float, getattr(self.heldout, metric).max(axis=(1, 2, 3)))
        return before, after

    @property
    def gain(self) -> float:
        """How far the worst held-out residual fell, relative to before [-]; NaN where either is unstable."""
        before, after = self.worst
        return 1.0 - after / before

    def lowered(self, metric: str) -> np.ndarray:
        """How far a metric fell per stiffness and axis over the held-out scenarios, (stiffness, 3) [-].

        An RMS is averaged as a root mean square, anything else as a mean. Scenarios that the first controller did not
        hold are left out.
        """
        before, after = getattr(self.heldout, metric)[:, self.held[0]]
        power = 2.0 if metric in ("rms", "true_rms") else 1.0
        now, then = np.mean(after**power, axis=0), np.mean(before**power, axis=0)
        # What was nothing and stays nothing, such as the clamped share of the linear loop, has not fallen.
        ratio: np.ndarray = np.divide(now, then, out=np.where(now > 0.0, np.inf, 1.0), where=then != 0.0)
        return 1.0 - ratio ** (1.0 / power)

    def unmet(self) -> str:
        """Which goal the closest point misses, where and by how much, or why freezing refuses it; "" if all are met."""
        judged = self.judged(1)
        radius = np.asarray(judged.margins.spectral_radius)
        if (radius >= 1.0).any():
            place = judged.place(int(np.argmax(radius)))
            return f"no stable point was found: at {place} the closest one has spectral radius {radius.max():.4f}"
        limits = self.spec.margin_goals
        normalised = np.asarray(margin_goals(judged.margins, limits).normalised)
        worst = {name: float(row.max()) for name, row in zip(limits, normalised, strict=True)}
        step = self.steps[-1]
        last = int(np.flatnonzero((step.state.path[:, step.state.leader] == step.state.leader_z).all(axis=1))[0])
        runs = step.state.hard[last, step.state.leader, len(limits) :]
        worst |= dict(zip(step.problem.hard_goals, map(float, np.nan_to_num(runs, nan=np.inf)), strict=True))
        name = max(worst, key=lambda goal: worst[goal], default="")
        missed = bool(name) and worst[name] > FEASIBLE
        if not self.feasible and not (missed and np.isfinite(worst[name])):
            return (
                "no point was found that has a score: of the one that came closest a run left the finite numbers or "
                "1 kN, or a ratio is to nothing"
            )
        if not missed:
            return f"it may not fly: freeze refuses {self.refused}" if self.refused else ""
        goal, limit = GOALS[name], self.spec.held[name]
        found = limit * worst[name] if goal.ceiling else limit / worst[name]
        where = ""
        if name in limits:
            where = f" at {judged.place(int(np.argmax(normalised[list(limits).index(name)])))}"
        elif name != OVERSHOOT:  # the linear loop's, of no scenario
            at = step.state.hard_at[last, step.state.leader, [*limits, *step.problem.hard_goals].index(name)]
            where = " in training"
            where += f", worst on {self.spec.experiment.stiffness[int(at)]:g} N/m" if np.isfinite(at) else ""
        return (
            f"no point meets every goal: {name} {goal.sign} {goal.amount(limit)} is missed by "
            f"{goal.amount(abs(found - limit), '.3g')}{where} by the point that came closest"
        )


def assess(history: SearchHistory, show: bool = False) -> TuneResult:
    """Choose among the starts on the validation scenarios, then compare with the controller before on held-out ones."""
    return assess_and(lambda _: None, history, show)[0]


def assess_and(
    explain: Callable[[FoundController], T], history: SearchHistory, show: bool = False
) -> tuple[TuneResult, Future[T]]:
    """The same, and beside the proof something of the controller that needs none: if that fails, the result stands.

    Args:
        explain: What to make of it.
        history: The search.
        show: Whether to show progress.
    """
    spec, state = history.spec, history.steps[-1].state
    candidates = _ranked(spec, state, show) if state.feasible else [spec.space.exact(state.leader_z)]
    met = scenarios(spec.experiment, spec.scenarios, spec.tune.heldout_seeds)
    with Beside(2) as beside:
        found = found_of(history, candidates[0])
        flying = beside.submit(in_float64(_first_to_fly), history, candidates, found) if state.feasible else None
        # The best is rarely refused: it is proven and explained meanwhile.
        explaining = beside.submit(in_float64(explain), found)
        before, (after,) = versus(spec, candidates[:1], met, show)
        chosen, refused = flying.result() if flying else (0, "")
        if chosen:
            found = found_of(history, candidates[chosen])
            explaining = beside.submit(in_float64(explain), found)
            before, (after,) = versus(spec, candidates[chosen : chosen + 1], met, show)
        runs: Metrics = jax.tree.map(lambda *fields: np.stack(fields), before, after)
        return TuneResult(**vars(found), heldout=runs, refused=refused), explaining


def _ranked(spec: TuneSpec, state: SearchState, show: bool) -> list[Params]:
    """The best controller of each start, the best first: on the validation scenarios, or without any in training.

    Runs of validation are as long as the experiment: who misses a hard goal there comes after who holds them all, the
    one that comes closest first.
    """
    order = np.argsort(state.best, kind="stable")[: min(spec.tune.starts, np.isfinite(state.best).sum())]
    candidates, value, missed = [*map(spec.space.exact, state.best_z[order])], state.best[order], np.zeros(len(order))
    if spec.tune.validation_seeds:
        met = scenarios(spec.experiment, spec.scenarios, spec.tune.validation_seeds)
        before, each = versus(spec, candidates, met, show)
        value, missed = np.array([(standing_of(spec, one, before), missed_by(spec, one, before)) for one in each]).T
    return [candidates[i] for i in np.lexsort((value, np.maximum(missed, FEASIBLE)))]


def _first_to_fly(history: SearchHistory, candidates: list[Params], best: FoundController) -> tuple[int, str]:
    """Place of the best that freezing accepts and that keeps its margins where the proof judges them, more than search.

    Args:
        history: The search.
        candidates: The best first.
        best: That one, with its margins.

    Returns:
        Else the place of the very best, and why freezing refuses it.
    """
    first = ""
    for i, params in enumerate(candidates):
        refused = refusal(history.spec, params)
        if not refused and (found_of(history, params) if i else best).proven:
            return i, ""
        first = first if i else refused
    return 0, first
