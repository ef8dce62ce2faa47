r"""Exact gradients of single goals on single tissues, from the program that the tuner has compiled already.

The loss is log score + `PENALTY` · Σ max(0, 1 − 1/g + headroom) over the hard goals g. Limits and stiffnesses are data:
with limits that nothing can miss its gradient is that of the log score; with one limit that nothing can meet

    ∇loss − ∇log score = PENALTY · n/g · ∇log g

where n counts the stiffnesses at which a margin is judged, here all the same one, and is 1 for a goal of the runs;
those of a family, held on each tissue, are looked at on one alone (`on_tissue`).

Of spectra that a run has corrected the search has compiled every constraint with its slopes
(`tuning.search.constraints`). With limits that nothing can meet all of them count, and

    ∇log g = g · ∇(1 − 1/g)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxmpc.xla.rows import repeated
from tuning.job.goals import GOALS
from tuning.objective.evaluated import HEADROOM, PENALTY
from tuning.objective.loss import Values
from tuning.objective.problem import Problem
from tuning.proof.found import FoundController
from tuning.search.constraints import Constraints
from tuning.search.mapping import corrected_at

FACTOR = 1e3
"""By so much a limit is moved to be out of reach, or in the reach of everybody."""
SCORE = "score"


class Slope(NamedTuple):
    """The score or a normalised goal at one vector."""

    value: float
    """[-]; NaN where unstable."""
    gradient: Float[np.ndarray, " size"]
    """Gradient of its logarithm, per unconstrained number."""
    beside: Float[np.ndarray, " others"]
    """Its values at the other vectors."""


def sloped(result: FoundController, z: np.ndarray) -> Problem:
    """The job, with slopes, at a vector that the last step has seen: by runs, or by spectra as a run corrects them."""
    step = result.steps[-1]
    return step.problem if step.spectra is None else corrected_at(step.spectra, step.state.memory, z)


def slopes(problem: Problem, z: np.ndarray, starts: int, others: np.ndarray | None = None) -> dict[str, Slope]:
    """The score under `SCORE`, and every hard goal that the problem sees, of one vector.

    Args:
        problem: Its margins are judged on one tissue (`judged_on`, `on_tissue`).
        z: Unconstrained parameters, (size,).
        starts: As many rows as its program was compiled for.
        others: Vectors whose values are wanted besides, (others, size).
    """
    others = np.empty((0, len(z))) if others is None else others
    return (_of_loss if problem.data.correction is None else _of_constraints)(problem, z, starts, others)


def _of_loss(problem: Problem, z: np.ndarray, starts: int, others: np.ndarray) -> dict[str, Slope]:
    names = [*problem.data.margins, *problem.hard_goals]
    own = len(names) + 1
    easier = {name: np.full(own + len(others), FACTOR) for name in (*problem.data.margins, *problem.data.hard)}
    for row, name in enumerate(names, 1):
        easier[name][row] = 1.0 / FACTOR
    seen = values_at(problem, np.concatenate([np.tile(z, (own, 1)), others]), starts, easier)
    found = {SCORE: Slope(float(seen.score[0]), seen.gradient[0], seen.score[own:])}
    for i, name in enumerate(names):
        copies = len(problem.data.judged_at) if name in problem.data.margins else 1
        reached = float(seen.hard[i + 1, i])
        gradient = (seen.gradient[i + 1] - seen.gradient[0]) * reached / (PENALTY * copies)
        found[name] = Slope(reached / FACTOR, gradient, seen.hard[own:, i] * FACTOR)
    return found


def _of_constraints(problem: Problem, z: np.ndarray, starts: int, others: np.ndarray) -> dict[str, Slope]:
    vectors = np.concatenate([z[None], others])
    harder = {
        name: _moved(problem, name, np.array(1.0 / FACTOR)) for name in (*problem.data.margins, *problem.data.hard)
    }
    constraints = Constraints(problem.with_limits(harder), starts)
    seen = constraints(vectors, repeated(problem.data.correction, len(vectors)))

    def slope(values: np.ndarray, slopes: np.ndarray) -> Slope:
        gradient = np.zeros(len(z))
        gradient[constraints.moved] = slopes
        return Slope(float(values[0]), gradient, values[1:])

    found = {SCORE: slope(np.where(seen.stable, np.exp(seen.values[:, 0]), np.nan), seen.slopes[0, 0])}
    cells = len(problem.data.judged_at)
    tissues = 1 if problem.data.believed is None else len(problem.data.scene.stiffness)
    column = 1
    for name in (*problem.data.margins, *problem.hard_goals):
        inverse = 1.0 + HEADROOM - seen.values[:, column]
        with np.errstate(divide="ignore", invalid="ignore"):
            reached = np.where(seen.stable, 1.0 / inverse, np.inf)
            found[name] = slope(reached / FACTOR, seen.slopes[0, column] * reached[0])
        column += cells if name in problem.data.margins else tissues
    return found


def values_at(problem: Problem, z: np.ndarray, starts: int, easier: Mapping[str, np.ndarray] | None = None) -> Values:
    """`Problem.differentiate` at any number of vectors with whole horizons, so many at a time: the same program.

    Args:
        problem: The problem.
        z: Unconstrained parameters, (rows, size).
        starts: As many rows as its program was compiled for.
        easier: How many times as easy to meet each row's hard limits are than the job's, (rows,) each; None is 1.
    """
    parts = []
    for first in range(0, len(z), starts):
        rows = np.minimum(np.arange(first, first + starts), len(z) - 1)
        limits: Any = {name: _moved(problem, name, factors[rows]) for name, factors in (easier or {}).items()}
        parts.append(problem.with_limits(limits).differentiate(z[rows], 1.0))
    whole: Values = jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(z)], *parts)
    return whole


def judged_on(problem: Problem, stiffness: float, believed: float = np.nan) -> Problem:
    """The same with all margins judged on one tissue, a family's while it holds K̂; NaN for its fixed gains."""
    data = problem.data
    held = None if data.believed is None else np.full(data.believed.shape, believed)
    return problem._replace(data=data._replace(judged_at=np.full(data.judged_at.shape, stiffness), believed=held))


def on_tissue(problem: Problem, which: int) -> Problem:
    """The same on one of the experiment's tissues alone."""
    # Plain arrays: JAX would compile each of these small things.
    data = problem.data

    def alone(per_tissue: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(per_tissue)[which], per_tissue.shape)

    def factors_alone(per_row: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(per_row)[:, which : which + 1], per_row.shape)

    scene = data.scene._replace(stiffness=alone(data.scene.stiffness))
    data = data._replace(
        scene=scene,
        reference=jax.tree.map(alone, data.reference),
        correction=jax.tree.map(factors_alone, data.correction),
    )
    return judged_on(problem._replace(data=data), *[float(scene.stiffness[0])] * 2)


def _moved(problem: Problem, name: str, easier: np.ndarray) -> np.ndarray:
    """Limits that are so many times as easy to meet."""
    limit = np.asarray((problem.data.margins if name in problem.data.margins else problem.data.hard)[name])
    found: np.ndarray = limit * easier if GOALS[name].ceiling else limit / easier
    return found
