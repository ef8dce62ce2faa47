"""The least risk on corrected spectra under all hard goals, from several points: sequential quadratic programming.

A minimum of this problem lies where several margins are at their limits and several tissues are equally bad: a corner,
where a descent on one penalised number crawls from side to side. SLSQP is given every margin on every tissue as a
constraint of its own, with its exact gradient, and takes some ten evaluations.

Source: D. Kraft, A software package for sequential quadratic programming, DFVLR-FB 88-28, 1988 (`scipy.optimize`).
"""

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.metrics import Metrics
from jaxmpc.xla.blocks import OverDevices
from tuning.job.spec import TuneSpec
from tuning.objective.loss import HEADROOM, constrained
from tuning.objective.measures import Data, ProblemStructure
from tuning.objective.problem import Problem
from tuning.search.in_step import Evaluated, in_step

REACH = 1.0
"""How far a search may go from where it begins, per unconstrained number: beyond, a correction says little."""
ITERATIONS, MOST = 20, 30
"""Most iterations and evaluations of a search: one takes one, unless a line search finds nothing, and others wait."""
TOLERANCE = 1e-4
"""Change of the log risk at which it stops [-]: corrections are good to some per cent."""


def minimised(
    spec: TuneSpec, spectra: Problem, z: Float[np.ndarray, "rows size"], factors: Metrics
) -> Float[np.ndarray, "rows size"]:
    """The best point of each of several searches; horizons, which have no slope at whole numbers, stay.

    Args:
        spec: The job.
        spectra: Its problem by spectra.
        z: Where to begin, unconstrained.
        factors: Correction of each search, each field (rows, stiffness, scenarios, 3).

    Returns:
        The least risk of all points seen that hold the hard goals; where none does, the one that comes closest.
    """
    moved = np.flatnonzero(~spec.space.whole)
    if not len(moved):
        return z
    program = values_and_slopes(spectra.structure, tuple(moved.tolist()))
    shared = program.everywhere(shared_of(spectra))

    size = at_a_time(len(z))

    def evaluate(searches: np.ndarray, x: np.ndarray) -> Evaluated:
        parts = []
        for first in range(0, len(x), size):
            rows = np.minimum(np.arange(first, first + size), len(x) - 1)
            own: Metrics = jax.tree.map(lambda field, of=searches[rows]: field[of], factors)
            parts.append(program(rows_of(spectra, x[rows], z[searches[rows]], own), shared))
        values, slopes = (np.concatenate(part)[: len(x)] for part in zip(*parts, strict=True))
        # Beyond the finite numbers nothing is held; from there SLSQP only steps back.
        return np.nan_to_num(values, nan=1.0, posinf=1.0), np.nan_to_num(slopes)

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


def at_a_time(searches: int) -> int:
    """Points that are evaluated by one call: all on a GPU, where that takes as long as for one; else one a core."""
    return jax.local_device_count() if jax.default_backend() == "cpu" else searches


def compile_ahead(spec: TuneSpec, spectra: Problem, searches: int) -> None:
    """Compile what so many searches of `minimised` run, before anything has been measured."""
    rows = at_a_time(searches)
    moved, z = np.flatnonzero(~spec.space.whole), np.tile(spec.space.encode(spec.space.base), (rows, 1))
    if len(moved):
        factors = jax.tree.map(lambda field: np.ones((rows, *field.shape)), spectra.data.reference)
        program = values_and_slopes(spectra.structure, tuple(moved.tolist()))
        program.compile(rows_of(spectra, z[:, moved], z, factors), shared_of(spectra))


def rows_of(spectra: Problem, x: np.ndarray, z: np.ndarray, factors: Metrics | None) -> tuple[Any, ...]:
    """What each row of `values_and_slopes` has of its own: all have the same limits."""
    limits = spectra.data.margins, spectra.data.hard
    return x, z, *jax.tree.map(lambda limit: np.full(len(x), np.asarray(limit, float)), limits), factors


def shared_of(spectra: Problem) -> Data:
    """Data but for what each row has of its own."""
    return spectra.data._replace(margins={}, hard={}, correction=None)


@cache
def values_and_slopes(structure: ProblemStructure, moved: tuple[int, ...]) -> OverDevices:
    """A compiled function of rows (numbers that move, the whole vectors, limits, corrections), and of data.

    It gives log risk and constraints, (rows, values), and their slopes, (rows, values, moved). Forward mode: some ten
    numbers move, and there are as many constraints as goals times tissues.
    """
    return OverDevices(_evaluated, {"structure": structure, "moved": moved})


def _evaluated(rows: Any, shared: Data, structure: ProblemStructure, moved: tuple[int, ...]) -> tuple[Array, Array]:
    x, z, margins, hard, factors = rows
    data = shared._replace(margins=margins, hard=hard, correction=factors)

    def values(x: Array) -> Array:
        return constrained(jnp.asarray(z).at[:, jnp.array(moved)].set(x), data, structure)

    found, push = jax.linearize(values, jnp.asarray(x))
    # A row depends on nothing but itself, so one direction serves them all.
    slopes = jax.vmap(lambda direction: push(jnp.broadcast_to(direction, x.shape)), out_axes=2)(jnp.eye(len(moved)))
    return found, slopes
