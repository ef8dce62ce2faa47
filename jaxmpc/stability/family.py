"""Margins of a family of controllers where the stiffness of the tissue is known, and known a little wrong.

While the schedule has the control, K̂ is held or moves slowly: each loop is judged with K̂ frozen, over the band of K_s/K̂
that the identification leaves open. How K̂ moves is no matter of margins but of trials.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.files.errors import InputError
from jaxmpc.law import schedule
from jaxmpc.law.gains import Gains
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla import ops
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64


def frozen(params: Params, stiffness: Any, path: LoopPath, width: Any = 1.0) -> tuple[Gains, Any, Any]:
    """Gains, damping [1/s] and Riccati residual [-] of a family at known stiffnesses K̂ (n,) [N/m]; traceable.

    Returns:
        Gains with the stiffnesses as leading dimension, damping (n,), residual ().
    """
    gains, residual = design_one(params, path.T_s, width, path.force_filter)

    family = gains.schedule
    assert family is not None

    def at(log_stiffness: Any) -> tuple[Gains, Any]:
        found, K2 = schedule.at(family, log_stiffness, ops)
        vectors: dict[str, Any] = {name: jnp.stack(getattr(found, name)) for name in ("gamma", "K", "L")}
        return found._replace(**vectors, force_filter=gains.force_filter), K2

    known, K2 = jax.vmap(at)(jnp.log(jnp.asarray(stiffness)))
    return known, K2, residual


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
