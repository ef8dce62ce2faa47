"""Margins of a family of controllers where the stiffness of the tissue is known, and known a little wrong.

While the schedule has the control, K̂ is held or moves slowly: each loop is judged with K̂ frozen, over the band of K_s/K̂
that the identification leaves open. How K̂ moves is no matter of margins but of trials.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.files.errors import InputError
from jaxmpc.law import schedule
from jaxmpc.law.gains import Gains
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.schedule import repetition_of
from jaxmpc.stability import Cells, Margins, cells_of, margins_of_cells, worst_of, worst_rates
from jaxmpc.stability.held_beat import HeldBeat, at_rates
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis import design, design_one, designed
from jaxmpc.synthesis.listening import Listening
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from jaxmpc.synthesis.timing import Timing
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.rows import repeated, reshaped

KNOWN, RATIOS = 25, 5
"""Known stiffnesses, log-spaced between the outer knots, and K_s/K̂ over the band, at which a schedule is judged."""

ROUNDED = 1e-9
"""Share by which two stiffnesses that are meant to be one differ at most [-]."""


def judged_where(
    listening: Listening, known: int = KNOWN, ratios: int = RATIOS
) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, " ratios"]]:
    """Where a family is judged: K̂ held at and between the knots [N/m], and K_s/K̂ over the band [-]."""
    places, band = np.array(listening.stiffness), listening.band
    between = np.geomspace(places[0], places[-1], known)
    # One that is a knot's but for rounding would be judged twice.
    apart = np.abs(between[:, None] / places - 1.0).min(axis=1) > ROUNDED
    return np.unique([*places, *between[apart]]), np.linspace(1.0 - band, 1.0 + band, ratios)


def held(gains: Gains, K2: Any, stiffness: Float[Array, " known"]) -> tuple[Gains, Float[Array, " known"]]:
    """Gains and damping [1/s] of one designed family while K̂ is held; traceable.

    Args:
        gains: Of the family, with its schedule.
        K2: Damping of its fixed gains [1/s].
        stiffness: K̂ [N/m], held within what the identification believes at most, as the law holds it; NaN where it is
            not known and the fixed gains have the control.

    Returns:
        Gains with the stiffnesses as leading dimension, damping (known,).
    """
    family = gains.schedule
    assert family is not None
    fixed = gains._replace(guard=None, schedule=None), jnp.asarray(K2)
    least, most = family.identification.least, family.identification.most

    def at(K_hat: Any) -> tuple[Gains, Any]:
        known = jnp.isfinite(K_hat)
        believed = ops.clip(jnp.log(jnp.where(known, K_hat, 1.0)), least, most)
        found, damping = schedule.at(family, believed, ops)
        vectors: dict[str, Any] = {name: jnp.stack(getattr(found, name)) for name in ("gamma", "K", "L")}
        found = found._replace(**vectors, force_filter=gains.force_filter)
        chosen: tuple[Gains, Any] = jax.tree.map(partial(jnp.where, known), (found, damping), fixed)
        return chosen

    by_stiffness: tuple[Gains, Any] = jax.vmap(at)(jnp.asarray(stiffness))
    return by_stiffness


def frozen(params: Params, stiffness: Any, path: LoopPath, width: Any = 1.0) -> tuple[Gains, Any, Any]:
    """Gains, damping [1/s] and Riccati residual [-] of a family at known stiffnesses K̂ (n,) [N/m]; traceable.

    Returns:
        Gains with the stiffnesses as leading dimension, damping (n,), residual ().
    """
    gains, residual = design_one(params, path.T_s, width, path.force_filter)
    return *held(gains, params.K2, stiffness), residual


_frozen = JitOnce(frozen)


@in_float64
def gains_on(params: Params, stiffness: Any, path: LoopPath) -> tuple[Gains, Float[np.ndarray, " stiffness"]]:
    """Gains and damping [1/s] of a controller on tissues (stiffness,) [N/m]: of one with knots those for each, known.

    Beyond the outer knots they are those that the law has there, whose K̂ is held (`held`). Without knots they are the
    same on all; either way plain arrays, with the tissues as leading dimension.
    """
    if params.listening is None:
        one = design(params, Timing(path.T_s), path.force_filter), params.K2
        wide = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(stiffness), *np.shape(leaf))), one)
    else:
        check_sampling(params, path.T_s)
        wide = _frozen(params, jnp.asarray(stiffness, float), path)[:2]
    found: tuple[Gains, np.ndarray] = jax.tree.map(np.asarray, wide)
    return found


def _held_cells(gains: Gains, K2: Any, residual: Any, stiffness: Any, ratios: Any, path: LoopPath) -> Cells:
    """One designed family with K̂ held at known stiffnesses, each on tissues K_s = K̂ · ratio."""
    one: Gains = jax.tree.map(lambda leaf: leaf[0], gains)
    each, damping = held(one, K2, stiffness)
    over_ratios = jax.vmap(contact_of, in_axes=(0, None, None))
    contacts = jax.vmap(over_ratios, in_axes=(0, 0, None))(stiffness[:, None] * ratios, damping, path)
    return cells_of(each, contacts, jnp.broadcast_to(residual, stiffness.shape))


_cells = JitOnce(_held_cells)


def _beating_cells(cells: Cells, beats: HeldBeat) -> Cells:
    """Each cell with each of the beats, (beats,), those of one after another."""
    tiled = jax.tree.map(lambda leaf: jnp.tile(leaf, len(cells.residual)), beats)
    return repeated(cells, len(beats.rate))._replace(held=tiled)


@in_float64
def family_margins(
    params: Params,
    stiffness: Float[Array, " known"] | Any,
    ratios: Float[Array, " ratios"] | Any,
    path: LoopPath,
    rates: Callable[[Repetition], Any] | None = None,
) -> Margins:
    """Stability margins of a family of controllers with K̂ held.

    Where it learns what beats of the heart repeat, the worst of having learned nothing and of learning at any rate; of
    the ratios, the rate of the one with the least gain reduction is sought.

    Args:
        params: One controller with knots.
        stiffness: Known stiffnesses K̂ (known,) [N/m].
        ratios: K_s/K̂, (ratios,) [-].
        path: Delay, sampling and filters of the loop.
        rates: Gives the only rates of the heart that count, (rates,) [rad/s]; None looks for the worst.

    Returns:
        Margins, each (known, ratios).

    Raises:
        InputError: The controller is a batch or has no knots.
    """
    if params.batch_shape or params.listening is None:
        raise InputError("params", "a batch, or without knots", "one controller with knots", "Take one with knots.")
    known, band = jnp.asarray(stiffness, float), jnp.asarray(ratios, float)
    gains, residual = designed(reshaped(params, 0, 1), path.T_s, path.force_filter)
    cells = _cells(gains, params.K2, residual, known, band, path.with_cutoff(params.velocity_cutoff))
    learning = repetition_of(gains)
    if learning is None:
        return reshaped(margins_of_cells(cells, ideal=path.ideal), 1, len(known), len(band))
    one: Repetition = jax.tree.map(lambda leaf: leaf[0], learning)
    beats = at_rates(one, worst_rates.looked_at(one) if rates is None else rates(one))
    found = margins_of_cells(_beating_cells(cells, beats), ideal=path.ideal)
    found = reshaped(found, 1, len(known), len(band), len(beats.rate))
    return worst_of(found) if rates is not None else worst_rates.closer(found, cells, beats, path.ideal)
