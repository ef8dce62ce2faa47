"""Trials as one compiled program: motions × robots on each × controllers, design and linear stability included."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.engine.arm_rollout import ArmSignals, Cell, Program, run
from jaxmpc.engine.forward_dynamics import implicit
from jaxmpc.engine.rollout import HIGHEST_FORCE, scalars
from jaxmpc.stability import ILL_POSED_ABOVE
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one
from jaxmpc.world.arm import chain
from jaxmpc.world.robot import Robot, RobotStructure
from jaxmpc.xla.blocks import over_blocks

AT_A_TIME = 12
"""Motions that run at a time on one device: with the trials on each, the lanes stay in the cache (measured)."""


@lru_cache(maxsize=8)
def block_program(kind: RobotStructure, preview: bool, varied: tuple[int, ...], structure: Any) -> Callable[..., Any]:
    """A compiled function of ((signals, own), (params, constant, path)).

    Args:
        kind: Structure of the arm's world.
        preview: Whether the controllers know the reference along H_p.
        varied: Which leaves of a `Robot`, its tissue's stiffness among them, are a trial's own.
        structure: Of a `Robot`.

    Returns:
        Status, time of trouble [s], spectral radius [-], each (motions, copies, controllers), RMS and largest |e| [N],
        with three axes besides. Of what it is called with, signals (motions, steps, …) and own, one
        array (motions, copies) per varied leaf, are dealt to the devices by motion; constant holds all leaves of
        a `Robot`, and path is that of the experiment but for the delay, which the robots have.
    """
    program = Program(chain(), kind, implicit, HIGHEST_FORCE)

    def block(batch: Any, shared: Any) -> Any:
        (signals, own), (params, constant, path) = batch, shared
        gains, residual = jax.vmap(lambda p: design_one(p, path.T_s))(params)
        leaves = list(constant)
        for k, values in zip(varied, own, strict=True):
            leaves[k] = values[..., None]
        robot: Robot = jax.tree.unflatten(structure, leaves)
        shape = (*own[0].shape, len(residual))
        stiffness, late = (jnp.broadcast_to(x, shape) for x in (robot.tissue.stiffness, robot.extra_delay))

        def radius(K_s: Any, extra: Any, g: Any, K2: Any) -> Any:
            return spectral_radius(closed_loop_matrix(g, contact_of(K_s, K2, replace(path, delay=1.0 + extra))))

        over_controllers = jax.vmap(radius)
        over_copies = jax.vmap(over_controllers, in_axes=(0, 0, None, None))
        radii = jax.vmap(over_copies, in_axes=(0, 0, None, None))(stiffness, late, gains, params.K2)

        apart = jax.vmap(lambda g: scalars(g, preview))(gains)
        apart, K2 = jax.tree.map(lambda value: jnp.broadcast_to(value, shape), (apart, params.K2))
        # Every operation of a run is elementwise, so arrays may stand for its scalars, as in `engine.arm_cells`.
        met = ArmSignals(*(jnp.moveaxis(signal, 0, -1)[..., None, None] for signal in signals))
        metrics, trouble, _ = run(program, Cell(apart, K2, robot), met, False)
        rms, peak = (jnp.moveaxis(field, 0, -1) for field in (metrics.rms, metrics.peak_error))

        lasted = jnp.isinf(trouble.diverged) & jnp.all(jnp.isfinite(rms), axis=-1)
        status = jnp.where(jnp.isinf(trouble.lost_contact), Status.OK, Status.LOST_CONTACT)
        status = jnp.where(lasted, status, Status.DIVERGED)
        status = jnp.where(radii < 1.0, status, Status.UNSTABLE)
        status = jnp.where((residual < ILL_POSED_ABOVE) & jnp.isfinite(radii), status, Status.ILL_POSED)
        when = jnp.minimum(trouble.diverged, trouble.lost_contact)
        kept = lasted[..., None]
        measured = (jnp.where(kept, field, jnp.nan) for field in (rms, peak))
        return status, jnp.where(jnp.isinf(when), jnp.nan, when), radii, *measured

    return over_blocks(block, AT_A_TIME)
