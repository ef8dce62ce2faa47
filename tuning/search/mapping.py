"""Space mapping: the spectra, corrected by what the arm measured, propose controllers; the arm measures them again.

    metric(z) ≈ metric_spectra(z) · metric_arm(z₀) / metric_spectra(z₀)      per tissue, scenario and axis

exact at z₀ and good around it, at a thousandth of a run's price. What spectra do not see follows what they do: a peak
the RMS, clamped samples the chatter. A round measures a handful of points side by side, takes the best as z₀, and on
each corrected model minimises the risk under all hard goals (`tuning.search.corrected`). Only what was measured counts:
what misleads costs a round.

Source: J. W. Bandler et al., Space Mapping: The State of the Art, IEEE Trans. Microwave Theory and Techniques 52(1),
2004; there "output space mapping".
"""

from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxmpc.metrics import Metrics
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.place import placed
from tuning.job.spec import TuneSpec
from tuning.objective.judged_cells import judged_cells
from tuning.objective.loss import Values
from tuning.objective.measures import with_stand_ins
from tuning.objective.problem import Problem
from tuning.search.corrected import minimised
from tuning.search.optimise import WORTH, note
from tuning.search.state import SearchState, load, save

PROPOSED = 2
"""Points measured in a round, for each start of the job."""
PATIENCE = 8
"""Rounds without gain until it stops."""
SPREAD = 0.3
"""Standard deviation, per unconstrained number, of where a search on the corrected spectra begins about its z₀."""
STREAM = 9
"""Stream of its random numbers, apart from those of starts and scenarios."""


class Measured(NamedTuple):
    """All points measured so far; rows not yet reached are NaN."""

    z: Float[np.ndarray, "points size"]
    loss: Float[np.ndarray, " points"]
    """[-]; NaN where the heart was not held."""
    correction: Metrics
    """Correction of the spectra, (points, stiffness, scenarios, 3)."""


def refine(
    spec: TuneSpec,
    problem: Problem,
    spectra: Problem,
    z: Float[np.ndarray, "points size"],
    folder: Path | None = None,
    name: str = "state-mapping.npz",
    show: bool = False,
) -> SearchState:
    """Look for better points around good ones, or continue from the state in its folder.

    Args:
        spec: The job.
        problem: Its problem by runs.
        spectra: The same by spectra (`spectra_of`).
        z: The points to begin with.
        folder: Where the state is kept; None keeps none.
        name: Under which name.
        show: Whether to show progress.

    Returns:
        One row per round; its slots hold what was measured side by side, no descent of one start.
    """
    rounds = spec.tune.mapping
    goals = len(spec.margin_goals) + len(problem.hard_goals), len(problem.soft_goals)
    state = SearchState.new(z, _nothing(rounds * len(z), z.shape[1], problem), rounds, goals)
    if folder is not None:
        state = load(folder, spec.digest, state, name)
    with progress("tune (mapping)", rounds, "rounds", show) as tick:
        while state.iteration < rounds and not state.stalled(PATIENCE, 0):
            values = problem.evaluate(state.z)
            state.record(values, True, WORTH, problem.hard_at(values.cells))
            state.memory = _entered(state.memory, state.iteration, state.z, values, spectra)
            state.iteration += 1
            tick(state.iteration, note(spec, state))
            beginnings = parents(state.memory, len(z), state.iteration, spec.tune.seed)
            if not beginnings:
                break
            if state.iteration < rounds:
                followed, begin = zip(*beginnings, strict=True)
                factors = jax.tree.map(lambda field, rows=list(followed): field[rows], state.memory.correction)
                state.z = minimised(spectra, np.stack(begin), factors)
            if folder is not None:
                save(folder, spec.digest, state, name)
    return state


def spectra_of(spec: TuneSpec, own: Problem, reference: Metrics) -> Problem:
    """A job by spectra, with what ratios are taken to as its problem by runs has it, and but for families margins.

    Between its knots a family differs little from what it is at them, and all their slopes take long.

    Args:
        spec: The job.
        own: Its problem by spectra, as the descent has it.
        reference: That of its problem by runs.
    """
    at = placed(judged_cells(spec, coarse=False)[0]) if own.data.believed is None else own.data.judged_at
    return own._replace(data=own.data._replace(judged_at=at, reference=reference))


def correction(fine: Metrics, coarse: Metrics) -> Metrics:
    """Factors that turn what the spectra say of a point into what was measured there."""

    def factor(measured: np.ndarray, said: np.ndarray) -> np.ndarray:
        usable = (said > 0.0) & np.isfinite(said)
        return np.where(usable, measured / np.where(usable, said, 1.0), 1.0)

    factors: Metrics = jax.tree.map(factor, fine, with_stand_ins(coarse))
    return factors


def corrected_at(spectra: Problem, measured: Measured, z: Float[np.ndarray, " size"]) -> Problem:
    """The spectra as what was measured at one of the points corrects them: equal to the runs there, and with slopes."""
    row = int(np.nanargmin(np.abs(measured.z - z).max(axis=1)))
    factors = placed(jax.tree.map(lambda field: field[row : row + 1], measured.correction))
    return spectra._replace(data=spectra.data._replace(correction=factors))


def parents(measured: Measured, count: int, after: int, seed: int) -> list[tuple[int, Float[np.ndarray, " size"]]]:
    """Which points the next searches take as z₀, and where they begin; none where no point held the heart.

    After the first round every point is followed as it stands. Later half of the searches follow the best points, the
    other half the very best, all from somewhere near.

    Args:
        measured: All points so far.
        count: How many searches.
        after: Rounds done.
        seed: Draws where they begin.
    """
    order = np.argsort(measured.loss, kind="stable")[: np.isfinite(measured.loss).sum()]
    if not len(order):
        return []
    if after == 1:
        return [(int(k), measured.z[k]) for k in np.resize(order, count)]
    chosen = np.concatenate([np.resize(order[: count // 2], count // 2), np.full(count - count // 2, order[0])])
    random = np.random.Generator(np.random.Philox([seed, STREAM, after]))
    near = SPREAD * random.normal(size=(count, measured.z.shape[1]))
    return [(int(k), measured.z[k] + away) for k, away in zip(chosen, near, strict=True)]


def _nothing(points: int, size: int, problem: Problem) -> Measured:
    cells = points, *problem.data.reference.rms.shape
    empty: Metrics = jax.tree.map(lambda field: np.full(cells, np.nan), problem.data.reference)
    return Measured(np.full((points, size), np.nan), np.full(points, np.nan), empty)


def _entered(measured: Measured, iteration: int, z: np.ndarray, values: Values, spectra: Problem) -> Measured:
    """With one round more."""
    held = np.all(np.isfinite(values.cells.rms), axis=(1, 2, 3))
    factors = correction(values.cells, spectra.cells(z, held))
    new = Measured(z, np.where(held, values.loss, np.nan), factors)

    def put(rows: np.ndarray, row: np.ndarray) -> np.ndarray:
        first = iteration * len(z)
        return np.concatenate([rows[:first], row, rows[first + len(z) :]])

    entered: Measured = jax.tree.map(put, measured, new)
    return entered
