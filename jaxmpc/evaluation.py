"""Evaluate controllers on an experiment: residuals and margins together, at each stiffness.

The public function is `jaxmpc.evaluate`; the module has another name so that importing it does not hide it.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxmpc.engine.arm_rollout import ArmSample
from jaxmpc.engine.rollout import Sample, scalars
from jaxmpc.engine.scene import (
    CellResults,
    ProgramSpec,
    ScenarioData,
    program_spec,
    scenario_data,
    simulate_cells,
    with_physics,
)
from jaxmpc.experiment import Experiment, Physics
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.contact import Contact
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64

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


class Designed(NamedTuple):
    """Controllers and the worlds that they meet, ready to be judged and run."""

    gains: Gains
    """(controllers, …)"""
    contacts: Contact
    """(controllers, stiffness)"""
    residual: Any
    """Residual of the Riccati equation, (controllers,) [-]."""


def designed(params: Params, scene: ScenarioData) -> Designed:
    """Design a batch of controllers; float64, traceable."""

    def one(p: Params) -> Designed:
        gains, residual = design_one(p, scene.path.T_s)
        contacts = jax.vmap(lambda K_s: contact_of(K_s, p.K2, scene.path))(scene.stiffness)
        return Designed(gains, contacts, residual)

    return jax.vmap(one)(params)


def judged(controllers: Designed, *, ideal: bool) -> Margins:
    """Margins of every controller on every tissue, (controllers, stiffness); float64, traceable."""
    rows, tissues = controllers.contacts.stiffness.shape
    # One dimension of cells is traced twice as fast as two nested ones.
    cells = jax.tree.map(lambda leaf: leaf.reshape(rows * tissues), controllers.contacts)
    gains, residual = jax.tree.map(lambda leaf: jnp.repeat(leaf, tissues, axis=0), controllers[::2])
    found = jax.vmap(lambda g, contact, r: margins_one(g, contact, ideal, r))(gains, cells, residual)
    margins: Margins = jax.tree.map(lambda leaf: leaf.reshape(rows, tissues), found)
    return margins


def ran(
    controllers: Designed, K2: Any, scene: ScenarioData, *, world: ProgramSpec, dtype: Any, traced: bool
) -> CellResults:
    """Every controller on every tissue, axis and motion; traceable."""
    gains = jax.vmap(lambda g: scalars(g, world.preview))(controllers.gains)
    return simulate_cells(world, gains, K2, controllers.contacts, scene, dtype, traced)


def outcome_of(found: Margins, run: CellResults) -> Outcome:
    """What margins and run say together."""
    finite = jnp.isinf(run.diverged) & jnp.all(jnp.isfinite(run.metrics.rms), axis=-1)
    status = jnp.where((found.status == Status.OK) & ~finite, Status.DIVERGED, found.status)
    usable = (status == Status.OK)[..., None]
    held = Metrics(*(jnp.where(usable, value, jnp.nan) for value in run.metrics))
    touching = jnp.isinf(run.lost_contact)
    status = jnp.where((status == Status.OK) & ~touching, Status.LOST_CONTACT, status)
    when = jnp.where(status == Status.LOST_CONTACT, run.lost_contact, run.diverged)
    return Outcome(held, found, status, jnp.where(jnp.isinf(when), jnp.nan, when), run.trace)


def shaped_outcome(found: Margins, run: CellResults, batch: tuple[int, ...]) -> Outcome:
    """`outcome_of` with the batch's shape instead of one leading dimension; traceable."""
    outcome: Outcome = jax.tree.map(lambda leaf: jnp.reshape(leaf, (*batch, *leaf.shape[1:])), outcome_of(found, run))
    return outcome


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
    controllers = designed(params, scene)
    found = judged(controllers, ideal=scene.path.ideal)
    return outcome_of(found, ran(controllers, params.K2, scene, world=world, dtype=dtype, traced=traced))


_designed = JitOnce(designed)
_judged = JitOnce(judged, static_argnames=("ideal",))
_outcome_of = JitOnce(shaped_outcome, static_argnames=("batch",))
_ran = JitOnce(ran, static_argnames=("world", "dtype", "traced"))


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
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[len(batch) :]), params)
    scene, world = scenario_data(experiment), program_spec(experiment)
    controllers = _designed(flat, scene)

    def judge() -> Margins:
        # A thread has a precision of its own.
        with jax.enable_x64(True):
            margins: Margins = _judged(controllers, ideal=scene.path.ideal)
        return margins

    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(controllers)):
        found, run = judge(), _ran(controllers, flat.K2, scene, world=world, dtype=precision, traced=trace)
    else:
        # Compiling is most of a first call, and the two programs compile side by side; the longer one begins.
        _judged.trace(controllers, ideal=scene.path.ideal)
        with ThreadPoolExecutor(1) as beside:
            pending = beside.submit(judge)
            run = _ran(controllers, flat.K2, scene, world=world, dtype=precision, traced=trace)
            found = pending.result()
    outcome: Outcome = _outcome_of(found, run, batch=batch)
    return outcome
