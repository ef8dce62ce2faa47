"""Controllers side by side on motion that no tuner saw, and their margins of both kinds, in one compiled program."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.engine.once import JitOnce
from jaxmpc.engine.rollout import scalars
from jaxmpc.experiment import Experiment
from jaxmpc.params import Params
from jaxmpc.scene import Scene, World, run_cells, world_of
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis import design_one
from tuning.objective import judged_contact, scene_over_seeds

KINDS = {"as run": False, "ideal": True}
"""Names of the two kinds of margins, and whether the damping is ideal."""


def compare(batch: Params, experiment: Experiment, seeds: Sequence[int]) -> tuple[np.ndarray, dict[str, Margins]]:
    """Residuals on every seed over the whole experiment, and margins, of a batch of controllers.

    Args:
        batch: The controllers, one leading dimension.
        experiment: What they meet.
        seeds: Motion seeds.

    Returns:
        Residual RMS (controllers, seeds, stiffness, 3), NaN where unstable [N]; and margins as `jaxmpc.margins` defines
        them, "as run" and "ideal", each field (controllers, stiffness).
    """
    scene = scene_over_seeds(experiment, seeds, experiment.duration, experiment.settle)
    world = world_of(experiment)
    rms, found = jax.tree.map(np.asarray, _compare(batch, scene, world))
    by_kind = {kind: Margins(*(field[..., i] for field in found)) for i, kind in enumerate(KINDS)}
    stable = by_kind["ideal" if world.ideal else "as run"].spectral_radius < 1.0
    rms = np.where(stable[..., None], rms, np.nan)
    return rms.reshape(*stable.shape, len(seeds), 3).swapaxes(1, 2), by_kind


@partial(JitOnce, static_argnames=("world",))
def _compare(batch: Params, scene: Scene, world: World) -> tuple[Any, Margins]:
    def one(params: Params) -> Any:
        gains, residual = design_one(params, scene.T_s)

        def on_tissue(K_s: Any) -> Any:
            contact = contact_of(
                K_s, params.K2, scene.T_s, scene.delay, world.ideal, scene.velocity_cutoff, scene.sensor_cutoff
            )
            kinds = [judged_contact(K_s, params.K2, scene, ideal) for ideal in KINDS.values()]
            judged = jax.tree.map(lambda *leaves: jnp.stack(leaves), *kinds)
            # With ideal damping both cuts are the same, so one program serves both kinds.
            return contact, jax.vmap(lambda contact: margins_one(gains, contact, False, residual))(judged)

        return scalars(gains, world.preview), *jax.vmap(on_tissue)(scene.stiffness)

    gains, contacts, found = jax.vmap(one)(batch)
    return run_cells(world, gains, batch.K2, contacts, scene, "float64").metrics.rms, found
