"""What is minimised: the soft goals over tissues and scenarios, the hard ones held, and its gradient.

It is the sum of what margins miss and of what runs do. Their slopes are programs of their own, which compile side by
side: the longer one takes two thirds of the time that one of both would.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmpc.engine.registry import ENGINES
from jaxmpc.metrics import Metrics
from jaxmpc.xla.plain import library
from tuning.objective.evaluated import HEADROOM, MarginEvaluation, RunEvaluation, at_rest, judge, loops_of, run, where
from tuning.objective.measures import Data, ProblemStructure, cells_of


class MarginValues(NamedTuple):
    """What margins say of all starts, each (starts, …)."""

    loss: Any
    """Price of what they miss [-]."""
    gradient: Any
    stable: Any
    M_s: Any
    """Peak sensitivity per stiffness at which margins are judged [-]."""
    hard: Any
    """Each goal at its worst, (starts, goals) [-]."""


class RunValues(NamedTuple):
    """What the runs of all starts say, each (starts, …)."""

    loss: Any
    """Log risk, and the price of what hard goals miss [-]."""
    gradient: Any
    score: Any
    worst: Any
    tissue: Any
    hard: Any
    """Each goal at its worst, (starts, goals) [-]."""
    soft: Any
    cells: Metrics


class Values(NamedTuple):
    """What one evaluation of all starts gives, each (starts, …)."""

    loss: Any
    gradient: Any
    score: Any
    """Risk of the soft goals [-]; NaN where unstable, or a run was lost."""
    worst: Any
    """Largest residual RMS over stiffness, axis and scenario; NaN where unstable [N]."""
    tissue: Any
    """Where the soft goals stand worst, index into the stiffnesses."""
    M_s: Any
    """Peak sensitivity per stiffness at which margins are judged [-]."""
    hard: Any
    """Hard goals at their worst, (starts, goals), margins first; met at 1 and below [-]."""
    soft: Any
    """Soft goals at their worst, (starts, goals) [-]."""
    cells: Metrics
    """(starts, stiffness, scenarios, 3)"""


def together(margins: MarginValues, runs: RunValues) -> Values:
    """What both say; traceable."""
    xp = library(margins, runs)
    return Values(
        loss=margins.loss + runs.loss,
        gradient=margins.gradient + runs.gradient,
        score=runs.score,
        worst=runs.worst,
        tissue=runs.tissue,
        M_s=margins.M_s,
        hard=xp.concatenate([margins.hard, runs.hard], axis=1),
        soft=runs.soft,
        cells=runs.cells,
    )


def margin_slopes(z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure) -> MarginValues:
    """What the margins of all starts say, and its gradient; traceable."""

    def total(z: Array) -> tuple[Array, MarginValues]:
        found = _margin_values(z, judge(loops_of(z, data, width, structure), data))
        return jnp.sum(found.loss), found

    found: MarginValues
    (_, found), gradient = jax.value_and_grad(total, has_aux=True)(z)
    return found._replace(gradient=gradient)


def run_slopes(
    z: Float[Array, "starts size"],
    data: Data,
    width: Any,
    structure: ProblemStructure,
    stable: Bool[Array, " starts"],
) -> RunValues:
    """What the runs of all starts say, in reverse mode where the engine has it, else in forward mode; traceable."""

    def values(z: Array) -> tuple[Array, RunValues]:
        found = _run_values(z, run(loops_of(z, data, width, structure), stable, data, structure))
        return found.loss, found

    def total(z: Array) -> tuple[Array, RunValues]:
        loss, found = values(z)
        return jnp.sum(loss), found

    def along(direction: Array) -> tuple[Array, RunValues]:
        # A start's loss is its own, so each parameter is one direction for all starts at once.
        _, slope, found = jax.jvp(values, (z,), (jnp.broadcast_to(direction, z.shape),), has_aux=True)
        return slope, found

    found: RunValues
    if "reverse" in ENGINES[structure.world.engine].modes:
        (_, found), gradient = jax.value_and_grad(total, has_aux=True)(z)
    else:
        slopes, found = jax.vmap(along, out_axes=(0, None))(jnp.eye(z.shape[1], dtype=z.dtype))
        gradient = slopes.T
    return found._replace(gradient=gradient)


def value_alone(z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure) -> Values:
    """Both without the slopes, which are NaN; traceable."""
    loops = loops_of(z, data, width, structure)
    judged = judge(loops, data)
    return together(_margin_values(z, judged), _run_values(z, run(loops, judged.stable, data, structure)))


def run_cells(
    z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure, stable: Bool[Array, " starts"]
) -> Metrics:
    """What is measured of all starts, and no goals; traceable."""
    cells: Metrics = cells_of(at_rest(loops_of(z, data, width, structure), stable), data, structure)
    held: Metrics = jax.tree.map(lambda field: where(stable, field, jnp.nan), cells)
    return held


def margin_constraints(
    z: Float[Array, "starts size"], data: Data, structure: ProblemStructure
) -> tuple[Float[Array, "starts values"], Bool[Array, " starts"]]:
    """The same as a program with constraints: what must be at most 0 of the margins; and what is stable; traceable."""
    judged = judge(loops_of(z, data, 1.0, structure), data)
    return jnp.reshape(1.0 + HEADROOM - judged.goals.inverse, (len(z), -1)), judged.stable


def run_constraints(
    z: Float[Array, "starts size"], data: Data, structure: ProblemStructure, stable: Bool[Array, " starts"]
) -> Float[Array, "starts values"]:
    """Log risk, then what must be at most 0 of the runs; traceable."""
    done = run(loops_of(z, data, 1.0, structure), stable, data, structure)
    runs = [jnp.where(stable[:, None], value, 1.0) for value in done.shortfall]
    return jnp.concatenate([done.log_risk[:, None], *runs], axis=1)


def _margin_values(z: Array, judged: MarginEvaluation) -> MarginValues:
    return MarginValues(judged.loss, jnp.full_like(z, jnp.nan), judged.stable, judged.margins.M_s, judged.worst)


def _run_values(z: Array, done: RunEvaluation) -> RunValues:
    def where_stable(value: Array) -> Array:
        return where(done.stable, value, jnp.nan)

    per_tissue = jnp.stack([jnp.max(goal, axis=(2, 3)) for goal in done.soft.values()])
    worst_soft = [jnp.max(goal, axis=(1, 2, 3)) for goal in done.soft.values()]
    return RunValues(
        loss=done.loss,
        gradient=jnp.full_like(z, jnp.nan),
        score=where_stable(done.risk),
        worst=where_stable(jnp.max(done.cells.rms, axis=(1, 2, 3))),
        tissue=jnp.argmax(jnp.max(per_tissue, axis=0), axis=1),
        hard=done.worst,
        soft=where_stable(jnp.stack(worst_soft, axis=1)),
        cells=jax.tree.map(where_stable, done.cells),
    )
