"""The one way from parameters to a judged run: design, close the loops, take margins, run, say what came out.

Evaluation, tuning, its held-out proof, sweeps and trials go through here, so that all mean the same loop, the same
status and the same moment.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmpc import described
from jaxmpc.engine.base import CellResults, ProgramSpec, ScenarioData
from jaxmpc.engine.registry import choose
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmSample
from jaxmpc.loop.linear import HIGHEST_FORCE, Sample
from jaxmpc.metrics import Metrics
from jaxmpc.stability import Margins, cells_of, margins_of_cells
from jaxmpc.stability.loop import contacts_of
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.world.robot import with_cutoff
from jaxmpc.xla import ops
from jaxmpc.xla.rows import reshaped


class ClosedLoops(NamedTuple):
    """Controllers, and the contacts through which they close their loops."""

    gains: Gains
    """(controllers, …)"""
    K2: Any
    """Damping, (controllers,) [1/s]."""
    contacts: Any
    """A `Contact`, (controllers, stiffness); the arm, which makes its own, needs None to run."""
    residual: Any
    """Residual of the Riccati equation, (controllers,) [-]."""
    velocity_cutoff: Any = None
    """Low-pass of the velocity that each controller brings, (controllers,) [rad/s]; None is the world's. The contacts
    have it already."""


class Outcome(NamedTuple):
    """What a batch of controllers came to; leading dimensions are the batch's."""

    metrics: Metrics
    """Residuals and effort, shape (…, stiffness, 3)."""
    margins: Margins
    """Margins of the loop as the experiment runs it, shape (…, stiffness)."""
    status: Int[Array, "..."]
    """A `Status` per stiffness: that of the margins; DIVERGED where a stable loop still ran away; with metrics,
    FORCE_LIMIT where force or residual left its limit, and LOST_CONTACT where the tip left a tissue that does not hold
    it."""
    when: Float[Array, "..."]
    """When it diverged, left a limit (both on the linear loop to 125 samples) or lost contact [s]; NaN where it did
    none of these."""
    trace: Sample | ArmSample | None
    """Every sample, shape (…, stiffness, 3, steps), if asked for."""

    def __repr__(self) -> str:
        return described.as_text(*described.outcome(self))

    def _repr_html_(self) -> str:
        return described.as_html(*described.outcome(self))


def close_loops(params: Params, stiffness: Any, path: LoopPath, width: Any = 1.0) -> ClosedLoops:
    """Design a batch of controllers and close a loop on every tissue; float64, traceable.

    Args:
        params: The controllers, one leading dimension.
        stiffness: Tissues, (stiffness,) [N/m].
        path: Delay and filters of the loop.
        width: Softness of the horizons [samples].
    """
    gains, residual = jax.vmap(lambda one: design_one(one, path.T_s, width, path.force_filter))(params)
    cutoff = params.velocity_cutoff
    return ClosedLoops(gains, params.K2, contacts_of(params.K2, stiffness, path.with_cutoff(cutoff)), residual, cutoff)


def margins_of(loops: ClosedLoops, *, ideal: bool) -> Margins:
    """Margins of every controller on every tissue, (controllers, stiffness); float64, traceable."""
    found = margins_of_cells(cells_of(loops.gains, loops.contacts, loops.residual), ideal=ideal)
    return reshaped(found, 1, *loops.contacts.stiffness.shape)


def run_loops(
    loops: ClosedLoops, scene: ScenarioData, *, world: ProgramSpec, dtype: Any, traced: bool = False
) -> CellResults:
    """Every controller on every tissue, axis and motion; traceable."""
    if scene.robot is not None and loops.velocity_cutoff is not None:
        # Behind the dimensions of motions and tissues, over which the robot's constants may differ.
        scene = scene._replace(robot=with_cutoff(scene.robot, loops.velocity_cutoff[None, None], ops))
    return choose(world).simulate(world, loops.gains, loops.K2, loops.contacts, scene, dtype, traced)


def per_motion(field: Any) -> Any:
    """A metric of the cells with a dimension for the motions, (controllers, stiffness, motions, 3)."""
    return field.reshape(*field.shape[:2], -1, 3)


def lasted_per_motion(run: CellResults) -> Any:
    """Whether each run stayed finite and in bounds to its end, (controllers, stiffness, motions)."""
    finite = jnp.all(jnp.isfinite(per_motion(run.metrics.rms)), axis=-1)
    return finite & jnp.all(per_motion(run.metrics.peak_force) < HIGHEST_FORCE, axis=-1)


def verdict(judged: Any, lasted: Any, diverged: Any, over_limit: Any, lost_contact: Any) -> tuple[Any, Any]:
    """Status and moment of each run, by the one rule: what the margins say comes first, then how the run ended.

    Args:
        judged: A `Status` of the margins.
        lasted: Whether the run stayed finite and in bounds to its end.
        diverged: When it did not; ∞ if never [s].
        over_limit: When the force or the residual left its limit; ∞ if never [s].
        lost_contact: When the tip left the tissue; ∞ if never [s].

    Returns:
        A `Status`; and when what it says happened, with that of the margins when the run diverged; NaN if never [s].
    """
    status = jnp.where((judged == Status.OK) & ~lasted, Status.DIVERGED, judged)
    when = diverged
    for name, moment in ((Status.FORCE_LIMIT, over_limit), (Status.LOST_CONTACT, lost_contact)):
        happened = (status == Status.OK) & jnp.isfinite(moment)
        status, when = jnp.where(happened, name, status), jnp.where(happened, moment, when)
    return status, jnp.where(jnp.isinf(when), jnp.nan, when)


def outcome_of(margins: Margins, run: CellResults) -> Outcome:
    """What margins and run say together; traceable."""
    lasted = jnp.all(lasted_per_motion(run), axis=-1)
    moments = (times.min(axis=-1) for times in (run.diverged, run.over_limit, run.lost_contact))
    status, when = verdict(margins.status, lasted, *moments)
    usable = ((margins.status == Status.OK) & lasted)[..., None]
    held: Metrics = jax.tree.map(lambda value: jnp.where(usable, value, jnp.nan), run.metrics)
    return Outcome(held, margins, status, when, run.trace)


def evaluate_block(
    params: Params, scene: ScenarioData, *, world: ProgramSpec, dtype: Any, traced: bool = False
) -> Outcome:
    """A flat batch of controllers on every stiffness and axis, in one go; traceable.

    Args:
        params: The controllers, one leading dimension.
        scene: Data of the experiment (`scenario_data`).
        world: Its structure (`program_spec`).
        dtype: Precision of the time stepping.
        traced: Keep every sample.
    """
    loops = close_loops(params, scene.stiffness, scene.path)
    margins = margins_of(loops, ideal=scene.path.ideal)
    return outcome_of(margins, run_loops(loops, scene, world=world, dtype=dtype, traced=traced))
