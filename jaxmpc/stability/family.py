"""Margins of a family of controllers where the stiffness of the tissue is known, and known a little wrong.

While the schedule has the control, K̂ is held or moves slowly: each loop is judged with K̂ frozen, over the band of K_s/K̂
that the identification leaves open. How K̂ moves is no matter of margins but of trials.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.files.errors import InputError
from jaxmpc.law import schedule
from jaxmpc.law.gains import Gains
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis import design, design_one
from jaxmpc.synthesis.listening import Listening
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.timing import Timing
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

KNOWN, RATIOS = 25, 5
"""Known stiffnesses, log-spaced between the outer knots, and K_s/K̂ over the band, at which a schedule is judged."""


def judged_where(
    listening: Listening, known: int = KNOWN, ratios: int = RATIOS
) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, " ratios"]]:
    """Where a family is judged: K̂ held at and between the knots [N/m], and K_s/K̂ over the band [-]."""
    places, band = listening.stiffness, listening.band
    return np.unique([*places, *np.geomspace(places[0], places[-1], known)]), np.linspace(
        1.0 - band, 1.0 + band, ratios
    )


def held(gains: Gains, K2: Any, stiffness: Float[Array, " known"]) -> tuple[Gains, Float[Array, " known"]]:
    """Gains and damping [1/s] of one designed family while K̂ is held; traceable.

    Args:
        gains: Of the family, with its schedule.
        K2: Damping of its fixed gains [1/s].
        stiffness: K̂ [N/m]; NaN where it is not known and the fixed gains have the control.

    Returns:
        Gains with the stiffnesses as leading dimension, damping (known,).
    """
    family = gains.schedule
    assert family is not None
    fixed = gains._replace(guard=None, schedule=None), jnp.asarray(K2)

    def at(K_hat: Any) -> tuple[Gains, Any]:
        known = jnp.isfinite(K_hat)
        found, damping = schedule.at(family, jnp.log(jnp.where(known, K_hat, 1.0)), ops)
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

    Without knots they are the same on all; either way plain arrays, with the tissues as leading dimension.
    """
    if params.listening is None:
        one = design(params, Timing(path.T_s), path.force_filter), params.K2
        wide = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(stiffness), *np.shape(leaf))), one)
    else:
        wide = _frozen(params, jnp.asarray(stiffness, float), path)[:2]
    found: tuple[Gains, np.ndarray] = jax.tree.map(np.asarray, wide)
    return found


def margins_over(params: Params, stiffness: Any, ratios: Any, path: LoopPath) -> Margins:
    """As `family_margins`; float64, traceable, differentiable."""
    gains, K2, residual = frozen(params, stiffness, path)

    def one(g: Gains, damping: Any, K_hat: Any, ratio: Any) -> Margins:
        return margins_one(g, contact_of(ratio * K_hat, damping, path), path.ideal, residual)

    over_ratios = jax.vmap(one, in_axes=(None, None, None, 0))
    found: Margins = jax.vmap(over_ratios, in_axes=(0, 0, 0, None))(gains, K2, jnp.asarray(stiffness), ratios)
    return found


_margins_over = JitOnce(margins_over)


@in_float64
def family_margins(
    params: Params, stiffness: Float[Array, " known"] | Any, ratios: Float[Array, " ratios"] | Any, path: LoopPath
) -> Margins:
    """Stability margins of a family of controllers with K̂ held.

    Args:
        params: One controller with knots.
        stiffness: Known stiffnesses K̂ (known,) [N/m].
        ratios: K_s/K̂, (ratios,) [-].
        path: Delay, sampling and filters of the loop.

    Returns:
        Margins, each (known, ratios).

    Raises:
        InputError: The controller is a batch or has no knots.
    """
    if params.batch_shape or params.listening is None:
        raise InputError("params", "a batch, or without knots", "one controller with knots", "Take one with knots.")
    found: Margins = _margins_over(params, jnp.asarray(stiffness, float), jnp.asarray(ratios, float), path)
    return found
