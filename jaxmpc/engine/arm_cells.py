"""One cell of the arm, run over motions × tissues × controllers."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.engine.arm_rollout import ArmSample, ArmSignals, Cell, Program, Trouble, run
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.world.robot import Robot


def over_arm_cells(
    program: Program, gains: Gains, K2: Any, robot: Robot, stiffness: Any, signals: ArmSignals, traced: bool
) -> tuple[Metrics, Trouble, ArmSample | None]:
    """Every controller on every tissue and motion.

    Controllers are the innermost dimension of the computation, as in `engine.cells`.

    Args:
        program: Arm and structure.
        gains: Taken apart into scalars, each (controllers,).
        K2: Damping, (controllers,) [1/s].
        robot: Constants, each one number or one per motion (motions,); the stiffness is left open.
        stiffness: (tissues,) [N/m].
        signals: With the motions as leading dimension.
        traced: Keep every sample.

    Returns:
        Metrics (controllers, tissues, 3·motions), troubles (controllers, tissues), and samples whose vectors
        are the second-to-last dimension: (controllers, tissues, 3 or 4, steps, …), of the first motion.
    """
    motions = signals.time.shape[0]
    shape = (motions, *jnp.shape(stiffness), *jnp.shape(K2))

    def everywhere(value: Any) -> Any:
        return jnp.broadcast_to(value, shape)

    robot = jax.tree.map(lambda leaf: leaf[:, None, None] if jnp.ndim(leaf) else leaf, robot)
    on_tissues = robot._replace(tissue=robot.tissue._replace(stiffness=everywhere(stiffness[:, None])))
    cells = Cell(jax.tree.map(everywhere, gains), everywhere(K2), on_tissues)
    # Every operation is elementwise, so arrays may stand for the scalars of the law; vmap traces three times longer.
    met = ArmSignals(*(jnp.moveaxis(signal, 0, -1)[..., None, None] for signal in signals))
    metrics, trouble, samples = run(program, cells, met, traced)

    def per_cell(leaf: Any) -> Any:
        return jnp.transpose(leaf, (3, 2, 1, 0)).reshape(*shape[:0:-1], 3 * motions)

    def kept(field: Any) -> Any:
        """(controllers, tissues, axes, steps, …) of the first motion."""
        axes = field if isinstance(field, tuple) else tuple(jnp.moveaxis(field, 1, 0))
        stacked = jnp.stack([jnp.broadcast_to(axis[..., 0, :, :], (*axis.shape[:-3], *shape[1:])) for axis in axes])
        return jnp.moveaxis(stacked, (-1, -2), (0, 1))

    first = jax.tree.map(lambda leaf: jnp.min(leaf, axis=0).T, trouble)
    return jax.tree.map(per_cell, metrics), first, None if samples is None else ArmSample(*map(kept, samples))
