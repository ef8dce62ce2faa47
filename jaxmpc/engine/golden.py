"""The golden trace: what the JAX loop's controller answered to recorded forces."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.engine.rollout import scalars
from jaxmpc.law import cascade
from jaxmpc.law.cascade import Gains
from jaxmpc.precision import in_float64


@in_float64
def law_trace(gains: Gains, force: np.ndarray, force_ref: np.ndarray, preview: bool) -> np.ndarray:
    """Commands of the JAX-traced law to a recorded run, after a reset to its first force.

    Args:
        gains: One controller.
        force: Measured force, shape (steps, 3) [N].
        force_ref: Wanted force, shape (steps, 3), with preview (steps, 3, H_p max) [N].
        preview: Whether the reference is known along H_p.

    Returns:
        Accelerations v, shape (steps, 3) [m/s²].
    """

    def one(state: cascade.ControllerState, now: tuple[Any, Any]) -> tuple[cascade.ControllerState, Any]:
        return cascade.step(apart, state, now[0], tuple(now[1]))

    def axis(force: Any, ref: Any) -> Any:
        return jax.lax.scan(one, cascade.init(force[0]), (force, ref))[1]

    apart = scalars(jax.tree.map(jnp.asarray, gains), preview)
    wanted = force_ref if preview else force_ref[:, :, None]
    return np.asarray(jax.jit(jax.vmap(axis, in_axes=1, out_axes=1))(jnp.asarray(force), jnp.asarray(wanted)))
