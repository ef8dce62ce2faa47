"""Trials as one compiled program: motions × robots on each × controllers, design and linear stability included."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.closed_loops import ClosedLoops, lasted_per_motion, per_motion, run_loops, verdict
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.stability import stability_status
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.synthesis import design_one
from jaxmpc.world.robot import Robot
from jaxmpc.xla.blocks import over_blocks

AT_A_TIME = 12
"""Motions that run at a time on one device: with the trials on each, the lanes stay in the cache (measured)."""


@lru_cache(maxsize=8)
def block_program(spec: ProgramSpec, varied: tuple[int, ...], structure: Any) -> Callable[..., Any]:
    """A compiled function of ((signals, own), (params, constant, path, force_limit)).

    Args:
        spec: Structure of a trial's program.
        varied: Which leaves of a `Robot`, its tissue's stiffness among them, are a trial's own.
        structure: Of a `Robot`.

    Returns:
        Status, time of trouble [s], spectral radius [-], when a guard took gain back (∞ if never) [s], each (motions,
        copies, controllers); RMS, true RMS, largest |e| and swing [N], with three axes besides. Of what it is called
        with, signals (motions, steps, …) and own, one array (motions, copies) per varied leaf, are dealt to the
        devices by motion; constant holds all leaves of a `Robot`, and path is that of the experiment but for the
        delay, which the robots have.
    """

    def block(batch: Any, shared: Any) -> Any:
        (signals, own), (params, constant, path, force_limit) = batch, shared
        gains, residual = jax.vmap(lambda p: design_one(p, path.T_s, 1.0, path.force_filter))(params)
        leaves = list(constant)
        for k, values in zip(varied, own, strict=True):
            leaves[k] = values
        robot: Robot = jax.tree.unflatten(structure, leaves)
        cells = own[0].shape
        stiffness = jnp.broadcast_to(robot.tissue.stiffness, cells)

        def radius(K_s: Any, extra: Any, g: Any, K2: Any) -> Any:
            return spectral_radius(closed_loop_matrix(g, contact_of(K_s, K2, replace(path, delay=1.0 + extra))))

        over_controllers = jax.vmap(radius, in_axes=(None, None, 0, 0))
        over_copies = jax.vmap(over_controllers, in_axes=(0, 0, None, None))
        over_motions = jax.vmap(over_copies, in_axes=(0, 0, None, None))
        radii = over_motions(stiffness, jnp.broadcast_to(robot.extra_delay, cells), gains, params.K2)

        data = ScenarioData(stiffness, signals, None, force_limit, robot, path)
        run = run_loops(ClosedLoops(gains, params.K2, None, residual), data, world=spec, dtype="float64")
        lasted = lasted_per_motion(run).T
        moments = run.diverged.T, run.over_limit.T, run.lost_contact.T
        status, when = verdict(stability_status(radii, residual), lasted, *moments)

        def per_trial(field: Any) -> Any:
            """With dimensions (motions, copies, controllers, 3), NaN where the run did not last."""
            return jnp.where(lasted[..., None], jnp.transpose(per_motion(field), (2, 1, 0, 3)), jnp.nan)

        found = run.metrics
        told = found.rms, found.true_rms, found.peak_error, found.swing
        return status, when, radii, run.backed_off.T, *map(per_trial, told)

    return over_blocks(block, AT_A_TIME)
