"""The least risk on corrected spectra under all hard goals, from one point: sequential quadratic programming.

A minimum of this problem lies where several margins are at their limits and several tissues are equally bad: a corner,
where a descent on one penalised number crawls from side to side. SLSQP is given every margin on every tissue as a
constraint of its own, with its exact gradient, and takes some ten evaluations.

Source: D. Kraft, A software package for sequential quadratic programming, DFVLR-FB 88-28, 1988 (`scipy.optimize`).
"""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.metrics import Metrics
from jaxmpc.xla.shared import JitShared
from jaxmpc.xla.store import kept_or_plain
from tuning.job.spec import TuneSpec
from tuning.objective.loss import HEADROOM, constrained
from tuning.objective.measures import Data, ProblemStructure
from tuning.objective.problem import Problem

REACH = 1.0
"""How far a search may go from where it begins, per unconstrained number: beyond, a correction says little."""
ITERATIONS = 20
TOLERANCE = 1e-4
"""Change of the log risk at which it stops [-]: corrections are good to some per cent."""


def minimised(
    spec: TuneSpec, spectra: Problem, z: Float[np.ndarray, " size"], factors: Metrics
) -> Float[np.ndarray, " size"]:
    """The best point of the search; horizons, which have no slope at whole numbers, stay.

    Args:
        spec: The job.
        spectra: Its problem by spectra.
        z: Where to begin, unconstrained.
        factors: Correction, each field (1, stiffness, scenarios, 3).

    Returns:
        The least risk of all points seen that hold the hard goals; where none does, the one that comes closest.
    """
    from scipy.optimize import minimize

    moved = np.flatnonzero(~spec.space.whole)
    if not len(moved):
        return z
    program, data = values_and_slopes(spectra.structure, tuple(moved.tolist())), _corrected(spectra, factors)
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = x.tobytes()
        if key not in seen:
            values, slopes = (np.asarray(part) for part in program(x, z, data))
            # Beyond the finite numbers nothing is held; from there SLSQP only steps back.
            seen[key] = np.nan_to_num(values, nan=1.0, posinf=1.0), np.nan_to_num(slopes)
        return seen[key]

    minimize(
        lambda x: at(x)[0][0],
        z[moved],
        jac=lambda x: at(x)[1][0],
        method="SLSQP",
        bounds=[(value - REACH, value + REACH) for value in z[moved]],
        constraints={"type": "ineq", "fun": lambda x: -at(x)[0][1:], "jac": lambda x: -at(x)[1][1:]},
        options={"maxiter": ITERATIONS, "ftol": TOLERANCE},
    )

    def rank(item: tuple[bytes, tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
        risk, *missed = item[1][0]
        # Half of the headroom is what the search may leave unused.
        worst = max(missed, default=0.0)
        return (0.0, risk) if worst <= 0.5 * HEADROOM else (worst, risk)

    found = z.copy()
    found[moved] = np.frombuffer(min(seen.items(), key=rank)[0])
    return found


def compile_ahead(spec: TuneSpec, spectra: Problem) -> None:
    """Compile what `minimised` runs, before anything has been measured."""
    moved, z = np.flatnonzero(~spec.space.whole), spec.space.encode(spec.space.base)
    if len(moved):
        factors = jax.tree.map(lambda field: jnp.ones((1, *field.shape)), spectra.data.reference)
        program = values_and_slopes(spectra.structure, tuple(moved.tolist()))
        program.compile(z[moved], z, _corrected(spectra, factors))


def _corrected(spectra: Problem, factors: Metrics) -> Data:
    """Data of one point."""
    limits = {name: jnp.reshape(jnp.asarray(limit, float), (1,)) for name, limit in spectra.data.margins.items()}
    runs = {name: jnp.reshape(jnp.asarray(limit, float), (1,)) for name, limit in spectra.data.hard.items()}
    corrected: Metrics = jax.tree.map(jnp.asarray, factors)
    return spectra.data._replace(margins=limits, hard=runs, correction=corrected)


@lru_cache(maxsize=8)
def values_and_slopes(structure: ProblemStructure, moved: tuple[int, ...]) -> JitShared:
    """A compiled function of (numbers that move, the whole vector, data): log risk and constraints, and their slopes.

    Forward mode: some ten numbers move, and there are as many constraints as goals times tissues.
    """
    return JitShared(partial(kept_or_plain, _evaluated, {"structure": structure, "moved": moved}))


def _evaluated(x: Any, z: Any, data: Data, structure: ProblemStructure, moved: tuple[int, ...]) -> tuple[Array, Array]:
    def values(x: Array) -> Array:
        return constrained(jnp.asarray(z).at[jnp.array(moved)].set(x)[None], data, structure)[0]

    found, push = jax.linearize(values, jnp.asarray(x))
    return found, jax.vmap(push, out_axes=1)(jnp.eye(len(moved)))
