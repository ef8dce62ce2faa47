"""The golden trace: forces of a simulated run, and what the JAX-traced law answered to them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.engine.once import JitOnce
from jaxmpc.engine.rollout import scalars
from jaxmpc.evaluation import evaluate_block
from jaxmpc.experiment import Experiment
from jaxmpc.law import cascade
from jaxmpc.law.cascade import Gains
from jaxmpc.params import Params
from jaxmpc.precision import in_float64
from jaxmpc.scene import scene_of, world_of


@in_float64
def simulated_run(params: Params, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Measured and wanted force of one controller at the experiment's middle stiffness.

    Returns:
        Force (steps, 3) [N], and wanted force (steps, 3), with preview (steps, 3, H_p max) [N].
    """
    scene = scene_of(experiment)
    middle = scene._replace(stiffness=scene.stiffness[len(scene.stiffness) // 2][None])
    world = world_of(experiment)

    @JitOnce
    def run(batch: Params) -> tuple[Any, Any]:
        # Of the outcome only the trace is returned, so nothing else is compiled.
        outcome = evaluate_block(batch, middle, world=world, dtype="float64", traced=True)
        assert outcome.trace is not None
        return outcome.trace.force[0, 0], outcome.trace.force_ref[0, 0]

    force, wanted = map(np.asarray, run(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], params)))
    wanted = np.moveaxis(wanted, 0, 1)
    return force.T, wanted if world.preview else wanted[:, :, 0]


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
        return jax.lax.scan(one, cascade.init(force[0], cascade.order(apart)), (force, ref))[1]

    apart = scalars(jax.tree.map(jnp.asarray, gains), preview)
    wanted = force_ref if preview else force_ref[:, :, None]
    return np.asarray(jax.jit(jax.vmap(axis, in_axes=1, out_axes=1))(jnp.asarray(force), jnp.asarray(wanted)))
