"""Trials as one compiled program: motions × robots on each × controllers, design and linear stability included."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.closed_loops import ClosedLoops, lasted_per_motion, per_motion, run_loops, verdict
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.loop.arm import ArmSignals
from jaxmpc.stability import stability_status
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.world.robot import Robot
from jaxmpc.xla.blocks import OverBlocks
from jaxmpc.xla.once import JitOnce

AT_A_TIME = 12
"""Motions that run at a time on a core: with the trials on each, the lanes stay in the cache (measured)."""


class Met(NamedTuple):
    """What differs from trial to trial; the first dimension is the motions'."""

    heart: Any
    """As in `ArmSignals`."""
    between: Any
    noise: Any
    own: Any
    """Leaves of a `Robot`, its tissue's stiffness among them, (motions, copies, leaves)."""


class Shared(NamedTuple):
    """What all trials share."""

    params: Params
    """Controllers of one structure."""
    robot: Any
    """All leaves of a `Robot`."""
    signals: ArmSignals
    """All signals, of one motion."""
    path: LoopPath
    """That of the experiment but for the delay, which the robots have."""
    force_limit: Any


@lru_cache(maxsize=8)
def wave_program(
    spec: ProgramSpec, varied: tuple[int, ...], structure: Any, motions: int
) -> Callable[[tuple[Met, ...], Shared], Any]:
    """A compiled function of what the blocks of a wave meet, and of what all share.

    Args:
        spec: Structure of a trial's program.
        varied: Which leaves of a `Robot` are a trial's own.
        structure: Of a `Robot`.
        motions: How many a wave has.

    Returns:
        Status, time of trouble [s], spectral radius [-], when a guard took gain back (∞ if never) [s], each (motions,
        copies, controllers); RMS, true RMS, largest |e| and swing [N], with three axes besides.
    """
    static = {"spec": spec, "varied": varied, "structure": structure}
    if jax.default_backend() == "cpu":
        dealt = OverBlocks(_of_motions, min(AT_A_TIME, motions), static)
        return lambda met, shared: dealt(jax.tree.map(lambda *parts: np.concatenate(parts), *met), shared)
    return partial(_of_blocks, **static)


def traced_ahead(
    program: Callable[[tuple[Met, ...], Shared], Any], met: tuple[Met, ...], shared: Shared
) -> Callable[[], None]:
    """Trace a GPU's `wave_program` for blocks like these; what is returned compiles it."""
    assert isinstance(program, partial)
    return _of_blocks.traced(met, shared, **program.keywords)


class Scene(NamedTuple):
    """Controllers and what they meet."""

    loops: ClosedLoops
    data: ScenarioData
    radii: Any
    """Spectral radius of each linear loop, (motions, copies, controllers) [-]."""


def scene_of(met: Met, shared: Shared, varied: tuple[int, ...], structure: Any) -> Scene:
    """Design the controllers, and put together what they meet; traceable. `varied` and `structure`: `wave_program`."""
    params, path = shared.params, shared.path
    gains, residual = jax.vmap(lambda p: design_one(p, path.T_s, 1.0, path.force_filter))(params)
    leaves = list(shared.robot)
    for place, k in enumerate(varied):
        leaves[k] = met.own[..., place]
    robot: Robot = jax.tree.unflatten(structure, leaves)
    cells = met.own.shape[:2]
    stiffness = jnp.broadcast_to(robot.tissue.stiffness, cells)

    def radius(K_s: Any, extra: Any, g: Any, K2: Any, cutoff: Any) -> Any:
        own = replace(path, delay=1.0 + extra).with_cutoff(cutoff)
        return spectral_radius(closed_loop_matrix(g, contact_of(K_s, K2, own)))

    over_controllers = jax.vmap(radius, in_axes=(None, None, 0, 0, 0))
    over_copies = jax.vmap(over_controllers, in_axes=(0, 0, None, None, None))
    over_motions = jax.vmap(over_copies, in_axes=(0, 0, None, None, None))
    late, cutoff = jnp.broadcast_to(robot.extra_delay, cells), params.velocity_cutoff
    radii = over_motions(stiffness, late, gains, params.K2, cutoff)

    common = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(met.own), *leaf.shape[1:])), shared.signals)
    signals = common._replace(heart=met.heart, between=met.between, noise=met.noise)
    data = ScenarioData(stiffness, signals, None, shared.force_limit, robot, path)
    return Scene(ClosedLoops(gains, params.K2, None, residual, cutoff), data, radii)


def _of_motions(met: Met, shared: Shared, *, spec: ProgramSpec, varied: tuple[int, ...], structure: Any) -> Any:
    """What `wave_program` returns, of some motions."""
    loops, data, radii = scene_of(met, shared, varied, structure)
    ran = run_loops(loops, data, world=spec, dtype="float64")
    lasted = lasted_per_motion(ran).T
    moments = ran.diverged.T, ran.over_limit.T, ran.lost_contact.T
    status, when = verdict(stability_status(radii, loops.residual), lasted, *moments)

    def per_trial(field: Any) -> Any:
        """With dimensions (motions, copies, controllers, 3), NaN where the run did not last."""
        return jnp.where(lasted[..., None], jnp.transpose(per_motion(field), (2, 1, 0, 3)), jnp.nan)

    found = ran.metrics
    told = found.rms, found.true_rms, found.peak_error, found.swing
    return status, when, radii, ran.backed_off.T, *map(per_trial, told)


def _joined(met: tuple[Met, ...], shared: Shared, *, spec: ProgramSpec, varied: tuple[int, ...], structure: Any) -> Any:
    joined: Met = jax.tree.map(lambda *parts: jnp.concatenate(parts), *met)
    return _of_motions(joined, shared, spec=spec, varied=varied, structure=structure)


_of_blocks = JitOnce(_joined, static_argnames=("spec", "varied", "structure"))
