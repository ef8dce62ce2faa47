"""The least risk on corrected spectra under all hard goals, from several points: sequential quadratic programming.

A minimum of this problem lies where several margins are at their limits and several tissues are equally bad: a corner,
where a descent on one penalised number crawls from side to side. SLSQP is given every margin on every tissue as a
constraint of its own, with its exact gradient, and takes some ten evaluations.

Source: D. Kraft, A software package for sequential quadratic programming, DFVLR-FB 88-28, 1988 (`scipy.optimize`).
"""

from collections.abc import Callable
from contextlib import suppress

import jax
import numpy as np
from jaxtyping import Float

from jaxmpc.metrics import Metrics
from tuning.objective.evaluated import HEADROOM
from tuning.objective.problem import Problem
from tuning.search.constraints import Constraints
from tuning.search.in_step import Evaluated, in_step

REACH = 1.0
"""How far a search may go from where it begins, per unconstrained number: beyond, a correction says little."""
ITERATIONS, MOST = 20, 30
"""Most iterations and evaluations of a search: one takes one, unless a line search finds nothing, and others wait."""
TOLERANCE = 1e-4
"""Change of the log risk at which it stops [-]: corrections are good to some per cent."""


def minimised(spectra: Problem, z: Float[np.ndarray, "rows size"], factors: Metrics) -> Float[np.ndarray, "rows size"]:
    """The best point of each of several searches; horizons, which have no slope at whole numbers, stay.

    Args:
        spectra: A job's problem by spectra.
        z: Where to begin, unconstrained.
        factors: Correction of each search, each field (rows, stiffness, scenarios, 3).

    Returns:
        The least risk of all points seen that hold the hard goals; where none does, the one that comes closest.
    """
    constraints = Constraints(spectra, len(z))
    moved = constraints.moved
    if not len(moved):
        return z

    def evaluate(searches: np.ndarray, x: np.ndarray) -> Evaluated:
        rows = z[searches]
        rows[:, moved] = x
        seen = constraints(rows, jax.tree.map(lambda field: field[searches], factors))
        # Beyond the finite numbers nothing is held; from there SLSQP only steps back.
        return np.nan_to_num(seen.values, nan=1.0, posinf=1.0), np.nan_to_num(seen.slopes)

    found = z.copy()
    found[:, moved] = in_step(_searched, z[:, moved], evaluate)
    return found


class _BudgetSpentError(Exception):
    """A search has evaluated what it may."""


def _searched(begin: np.ndarray, evaluate: Callable[[np.ndarray], Evaluated]) -> np.ndarray:
    """One search: what moves at its best point."""
    from scipy.optimize import minimize

    seen: dict[bytes, Evaluated] = {}

    def at(x: np.ndarray) -> Evaluated:
        key = x.tobytes()
        if key not in seen:
            if len(seen) == MOST:
                raise _BudgetSpentError
            seen[key] = evaluate(x)
        return seen[key]

    with suppress(_BudgetSpentError):
        minimize(
            lambda x: at(x)[0][0],
            begin,
            jac=lambda x: at(x)[1][0],
            method="SLSQP",
            bounds=[(value - REACH, value + REACH) for value in begin],
            constraints={"type": "ineq", "fun": lambda x: -at(x)[0][1:], "jac": lambda x: -at(x)[1][1:]},
            options={"maxiter": ITERATIONS, "ftol": TOLERANCE},
        )

    def rank(item: tuple[bytes, Evaluated]) -> tuple[float, float]:
        risk, *missed = item[1][0]
        # Half of the headroom is what the search may leave unused.
        worst = max(missed, default=0.0)
        return (0.0, risk) if worst <= 0.5 * HEADROOM else (worst, risk)

    return np.frombuffer(min(seen.items(), key=rank)[0])
