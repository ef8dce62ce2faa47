"""Evaluate controllers on an experiment: residuals and margins together, at each stiffness.

The public function is `jaxmpc.evaluate`; the module has another name so that importing it does not hide it.
"""

from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxmpc.engine.cells import over_cells
from jaxmpc.engine.rollout import AxisSignals, Sample, record, run, scalars
from jaxmpc.errors import InputError, nearest
from jaxmpc.experiment import Experiment
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.params import Params
from jaxmpc.precision import in_float64
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.status import Status
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import Contact, hertz

Physics = Literal["linear"]
Precision = Literal["float64", "float32"]

HIGHEST_FORCE = 1e3
"""A run whose force leaves this is DIVERGED [N]."""


class Outcome(NamedTuple):
    """What `evaluate` found; leading dimensions are the batch's."""

    metrics: Metrics
    """Residuals and effort, shape (…, stiffness, 3)."""
    margins: Margins
    """Margins of the loop as the experiment runs it, shape (…, stiffness)."""
    status: Int[Array, "..."]
    """A `Status` per stiffness: that of the margins, or DIVERGED where a stable loop still ran away."""
    trace: Sample | None
    """Every sample, shape (…, stiffness, 3, steps), if asked for."""


class Scene(NamedTuple):
    """An experiment as arrays for the compiled program: all of it is data, none of it structure."""

    stiffness: Any
    signals: AxisSignals
    lsb: Any
    T_s: Any
    delay: Any
    velocity_cutoff: Any
    sensor_cutoff: Any


def scene_of(experiment: Experiment) -> Scene:
    """The arrays of an experiment, axes first in its signals."""
    heart, noise, wanted, score = (np.moveaxis(signal, 1, 0) for signal in experiment.signals)
    if experiment.reference.preview:
        ahead = np.lib.stride_tricks.sliding_window_view(wanted, wanted.shape[1] - experiment.steps + 1, axis=1)
        wanted = ahead[:, :, 1:]
    else:
        wanted = wanted[:, :, None]
    return Scene(
        np.asarray(experiment.stiffness),
        AxisSignals(*map(jnp.asarray, (heart, noise, wanted, score))),
        np.asarray(experiment.sensor.lsb),
        experiment.sampling_time,
        float(experiment.delay),
        experiment.velocity_lowpass,
        hertz(experiment.sensor.lowpass_hz),
    )


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


def evaluate_block(
    params: Params, scene: Scene, *, ideal: bool, preview: bool, dtype: Any, traced: bool = False
) -> Outcome:
    """A flat batch of controllers on every stiffness and axis, in one go; traceable.

    Args:
        params: The controllers, one leading dimension.
        scene: The experiment (`scene_of`).
        ideal: Whether its damping is ideal.
        preview: Whether its reference is known along H_p.
        dtype: Precision of the time stepping.
        traced: Keep every sample.
    """
    gains, contacts, found = jax.vmap(lambda p: design_and_margins(p, scene, ideal))(params)
    gains = jax.vmap(lambda g: scalars(g, preview))(gains)
    cells = as_dtype((gains, contacts, scene.lsb, scene.signals), dtype)
    measured = over_cells(run, *cells)
    finite = jnp.all((measured.peak_force < HIGHEST_FORCE) & jnp.isfinite(measured.rms), axis=-1)
    status = jnp.where((found.status == Status.OK) & ~finite, Status.DIVERGED, found.status)
    usable = (status == Status.OK)[..., None]
    held = Metrics(*(jnp.where(usable, value, jnp.nan) for value in measured))
    return Outcome(held, found, status, over_cells(record, *cells) if traced else None)


def as_dtype(tree: Any, dtype: Any) -> Any:
    """Floating leaves in another precision; masks stay what they are."""

    def cast(leaf: Any) -> Any:
        leaf = jnp.asarray(leaf)
        return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(cast, tree)


_evaluate = jax.jit(evaluate_block, static_argnames=("ideal", "preview", "dtype", "traced"))


@in_float64
def evaluate(
    params: Params,
    experiment: Experiment,
    *,
    physics: Physics = "linear",
    precision: Precision = "float64",
    trace: bool = False,
) -> Outcome:
    """Run controllers through an experiment.

    Never raises for a bad controller: its `status` says what happened and its metrics are NaN. For many
    thousands of controllers use `sweeps.run`, which works in blocks on all cores.

    Args:
        params: One controller or a batch.
        experiment: What they meet.
        physics: "linear", the contact loop.
        precision: Of the time stepping; design and margins are always float64.
        trace: Keep every sample of every signal.

    Returns:
        Metrics and margins per stiffness (and axis); see `Outcome`.

    Raises:
        InputError: The physics or precision is unknown.
    """
    for key, value, kind in (("physics", physics, Physics), ("precision", precision, Precision)):
        if value not in get_args(kind):
            raise InputError(key, value, "a known one", nearest(str(value), list(get_args(kind))))
    batch = params.batch_shape
    flat = jax.tree.map(lambda leaf: jnp.reshape(leaf, (-1, *jnp.shape(leaf)[len(batch) :])), params)
    outcome: Outcome = _evaluate(
        flat,
        scene_of(experiment),
        ideal=experiment.damping == "ideal",
        preview=experiment.reference.preview,
        dtype=precision,
        traced=trace,
    )
    shaped: Outcome = jax.tree.map(lambda leaf: jnp.reshape(leaf, (*batch, *leaf.shape[1:])), outcome)
    return shaped
