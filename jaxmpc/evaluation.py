"""Evaluate controllers on an experiment: residuals and margins together, at each stiffness.

The public function is `jaxmpc.evaluate`; the module has another name so that importing it does not hide it.
"""

from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmpc.engine.arm_rollout import ArmSample
from jaxmpc.engine.once import JitOnce
from jaxmpc.engine.rollout import Sample, scalars
from jaxmpc.errors import InputError, nearest
from jaxmpc.experiment import Experiment, Physics
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.params import Params
from jaxmpc.precision import in_float64
from jaxmpc.scene import Scene, World, run_cells, scene_of, with_physics, world_of
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import Contact

Precision = Literal["float64", "float32"]


class Outcome(NamedTuple):
    """What `evaluate` found; leading dimensions are the batch's."""

    metrics: Metrics
    """Residuals and effort, shape (…, stiffness, 3)."""
    margins: Margins
    """Margins of the loop as the experiment runs it, shape (…, stiffness)."""
    status: Int[Array, "..."]
    """A `Status` per stiffness: that of the margins; DIVERGED where a stable loop still ran away; LOST_CONTACT,
    with metrics, where the tip left a tissue that does not hold it."""
    when: Float[Array, "..."]
    """When it diverged (on the linear loop to 125 samples) or lost contact [s]; NaN where it did neither."""
    trace: Sample | ArmSample | None
    """Every sample, shape (…, stiffness, 3, steps), if asked for."""


def design_and_margins(
    params: Params, scene: Scene, ideal: bool, mask_width: Any = 1.0
) -> tuple[Gains, Contact, Margins]:
    """One controller's gains, its worlds and its margins, the latter two per stiffness; float64, traceable."""
    gains, residual = design_one(params, scene.T_s, mask_width)

    def one(K_s: Any) -> tuple[Contact, Margins]:
        contact = contact_of(K_s, params.K2, scene.T_s, scene.delay, ideal, scene.velocity_cutoff, scene.sensor_cutoff)
        return contact, margins_one(gains, contact, ideal, residual)

    contacts, found = jax.vmap(one)(scene.stiffness)
    return gains, contacts, found


def evaluate_block(params: Params, scene: Scene, *, world: World, dtype: Any, traced: bool = False) -> Outcome:
    """A flat batch of controllers on every stiffness and axis, in one go; traceable.

    Args:
        params: The controllers, one leading dimension.
        scene: Data of the experiment (`scene_of`).
        world: Its structure (`world_of`).
        dtype: Precision of the time stepping.
        traced: Keep every sample.
    """
    gains, contacts, found = jax.vmap(lambda p: design_and_margins(p, scene, world.ideal))(params)
    gains = jax.vmap(lambda g: scalars(g, world.preview))(gains)
    ran = run_cells(world, gains, params.K2, contacts, scene, dtype, traced)
    finite = jnp.isinf(ran.diverged) & jnp.all(jnp.isfinite(ran.metrics.rms), axis=-1)
    status = jnp.where((found.status == Status.OK) & ~finite, Status.DIVERGED, found.status)
    usable = (status == Status.OK)[..., None]
    held = Metrics(*(jnp.where(usable, value, jnp.nan) for value in ran.metrics))
    touching = jnp.isinf(ran.lost_contact)
    status = jnp.where((status == Status.OK) & ~touching, Status.LOST_CONTACT, status)
    when = jnp.where(status == Status.LOST_CONTACT, ran.lost_contact, ran.diverged)
    return Outcome(held, found, status, jnp.where(jnp.isinf(when), jnp.nan, when), ran.trace)


_evaluate = JitOnce(evaluate_block, static_argnames=("world", "dtype", "traced"))


@in_float64
def evaluate(
    params: Params,
    experiment: Experiment,
    *,
    physics: Physics | None = None,
    precision: Precision = "float64",
    trace: bool = False,
) -> Outcome:
    """Run controllers through an experiment.

    Never raises for a bad controller: its `status` says what happened and its metrics are NaN. For many
    thousands of controllers use `sweeps.run`, which works in blocks on all cores.

    Args:
        params: One controller or a batch.
        experiment: What they meet.
        physics: "linear", the contact loop; "wam", the arm; "mjx", the arm on stock MJX. None is the experiment's own.
        precision: Of the time stepping; design and margins are always float64.
        trace: Keep every sample of every signal.

    Returns:
        Metrics and margins per stiffness (and axis); see `Outcome`.

    Raises:
        InputError: The physics or precision is unknown.
    """
    experiment = with_physics(experiment, physics)
    for key, value, kind in (("physics", experiment.physics, Physics), ("precision", precision, Precision)):
        if value not in get_args(kind):
            raise InputError(key, value, "a known one", nearest(str(value), list(get_args(kind))))
    batch = params.batch_shape
    flat = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *jnp.shape(leaf)[len(batch) :])), params)
    outcome: Outcome = _evaluate(
        flat,
        scene_of(experiment),
        world=world_of(experiment),
        dtype=precision,
        traced=trace,
    )
    shaped: Outcome = jax.tree.map(lambda leaf: jnp.reshape(leaf, (*batch, *leaf.shape[1:])), outcome)
    return shaped
