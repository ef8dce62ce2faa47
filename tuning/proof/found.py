"""What a tuning run has found, before it is proven: a controller, its margins, and the search."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from jaxmpc import margins
from jaxmpc.stability import Margins
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.place import on_cpu
from tuning.job.goals import margin_goals
from tuning.job.spec import TuneSpec
from tuning.search.run import SearchHistory, Step
from tuning.search.state import FEASIBLE, SearchState

KINDS = {"as run": False, "ideal": True}
"""Names of the two kinds of margins, and whether the damping is ideal."""


class JudgedMargins(NamedTuple):
    """Margins that goals are about, each (cells,): of the fixed gains, and of a family with the stiffness known."""

    margins: Margins
    stiffness: np.ndarray
    """K_s [N/m]."""
    believed: np.ndarray
    """K̂ that a family holds [N/m]; NaN for fixed gains."""

    def place(self, cell: int) -> str:
        """Where a cell is."""
        return place_of(self.stiffness[cell], self.believed[cell])


def place_of(stiffness: float, believed: float) -> str:
    """A tissue, and what a family believes of it."""
    known = f" held for {believed:.4g} N/m" if np.isfinite(believed) else ""
    return f"{stiffness:.4g} N/m{known}"


@dataclass(frozen=True)
class FoundController:
    """Before and after, and the search between. Index 0 is the controller before, 1 the tuned one."""

    spec: TuneSpec
    params: Params
    """The tuned controller; without a feasible point, the one that came closest."""
    feasible: bool
    """Whether it holds every hard goal at every stiffness at which margins are judged."""
    margins: dict[str, Margins]
    """"as run" and "ideal", each field (2, judged_at); of a family those of its fixed gains."""
    known: tuple[JudgedMargins | None, JudgedMargins | None]
    """Margins of families with the stiffness known, as `jaxmpc freeze` judges them."""
    steps: list[Step]
    """The descent, and on the arm the rounds of space mapping."""
    orders: dict[int, float]
    """Score of each disturbance order after its descent [-]."""

    def judged(self, which: int) -> JudgedMargins:
        """Everything whose margins are judged of the controller before (0) or after (1)."""
        found = self.margins["ideal" if self.spec.ideal else "as run"]
        fixed: Margins = jax.tree.map(lambda field: field[which], found)
        at = self.spec.judged_at
        parts = [JudgedMargins(fixed, at, np.full(len(at), np.nan)), self.known[which]]
        whole: JudgedMargins = jax.tree.map(lambda *leaves: np.concatenate(leaves), *filter(None, parts))
        return whole

    @property
    def proven(self) -> bool:
        """Whether it is stable with every margin that is a goal, wherever margins are judged."""
        found = self.judged(1).margins
        goals = np.asarray(margin_goals(found, self.spec.margin_goals).normalised)
        return bool((goals <= FEASIBLE).all() and (np.asarray(found.spectral_radius) < 1.0).all())

    def stable(self, ideal: bool) -> np.ndarray:
        """Whether the loop is stable on each of the experiment's tissues, to a family known, (2, stiffness).

        Args:
            ideal: Whether it is the ideal one; of a family always the one that is judged.
        """
        found = np.asarray(self.margins["ideal" if ideal else "as run"].spectral_radius)
        rows = found[:, np.searchsorted(self.spec.judged_at, self.tissues)] < 1.0
        for row, family in zip(rows, self.known, strict=True):
            if family is not None:
                away = np.abs(np.stack([family.stiffness, family.believed])[:, None] - np.array(self.tissues)[:, None])
                row[:] = np.asarray(family.margins.spectral_radius)[np.argmin(away.sum(axis=0), axis=1)] < 1.0
        return rows

    @property
    def tissues(self) -> tuple[float, ...]:
        """The experiment's [N/m]."""
        return self.spec.experiment.stiffness

    @property
    def state(self) -> SearchState:
        """Histories of the last step."""
        return self.steps[-1].state


def found_of(history: SearchHistory, params: Params) -> FoundController:
    """One controller of a search, with its margins."""
    spec = history.spec
    found = {name: _judged(spec, params, ideal) for name, ideal in KINDS.items()}
    known = _known(spec, spec.before), _known(spec, params)
    feasible = history.steps[-1].state.feasible
    return FoundController(spec, params, feasible, found, known, history.steps, history.orders)


def rehearse(spec: TuneSpec) -> None:
    """Compile what `found_of` runs."""
    for ideal in KINDS.values():
        _judged(spec, spec.space.base, ideal)
    _known(spec, spec.space.base)


@on_cpu()
def _judged(spec: TuneSpec, params: Params, ideal: bool) -> Margins:
    """Margins of the controller before and of another, (2, judged_at)."""
    both = [margins(p, spec.judged_at, path=spec.experiment.loop_path(ideal)) for p in (spec.before, params)]
    found: Margins = jax.tree.map(lambda *fields: np.stack(fields), *both)
    return found


@on_cpu()
def _known(spec: TuneSpec, params: Params) -> JudgedMargins | None:
    """Margins of a family with the stiffness known; None of a controller without knots."""
    if params.listening is None:
        return None
    known, ratios = judged_where(params.listening)
    found = family_margins(params, known, ratios, spec.experiment.loop_path(spec.ideal))
    flat: Margins = jax.tree.map(np.ravel, found)
    return JudgedMargins(flat, np.outer(known, ratios).ravel(), np.repeat(known, len(ratios)))
