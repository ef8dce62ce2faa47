"""The linear loop over time as a scan, over every controller, stiffness and axis."""

from collections.abc import Callable
from math import inf
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc import swing
from jaxmpc.engine.episode import STRETCH, AxisEpisode, AxisLane, AxisProgress
from jaxmpc.law.gains import Gains
from jaxmpc.loop.linear import AxisSignals, LinearCarry, Sample, advance, start
from jaxmpc.metrics import Metrics, metrics, no_joints
from jaxmpc.world.contact import Contact
from jaxmpc.xla import ops


def over_cells(
    function: Callable[..., Any], gains: Gains, contacts: Contact, lsb: Any, signals: AxisSignals, *shared: Any
) -> Any:
    """f(gains, contact, lsb, signals, …) for every cell of a batch.

    Controllers are the innermost dimension of the computation: they alone differ in everything and are
    many, so each operation runs over contiguous memory (three axes innermost cost a factor of three).

    Args:
        function: `run` or `record`.
        gains: Taken apart into scalars, each (controllers,).
        contacts: Each (controllers, stiffnesses).
        lsb: Quantisation per axis, (3,) [N].
        signals: Axis first, (3, steps, …); its acceleration may be None.
        shared: What is the same for all.

    Returns:
        What the function returns, with leading dimensions (controllers, stiffnesses, 3).
    """

    def one(*cell: Any) -> Any:
        return function(*cell, *shared)

    over_controllers = jax.vmap(one, in_axes=(0, 0, None, None))
    over_axes = jax.vmap(over_controllers, in_axes=(None, None, 0, 0))
    over_stiffness = jax.vmap(over_axes, in_axes=(None, 1, None, None))
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 2, 0), over_stiffness(gains, contacts, lsb, signals))


def run(
    gains: Gains, contact: Contact, lsb: Any, signals: AxisSignals, force_limit: Any = inf
) -> tuple[Metrics, Any, Any]:
    """Metrics of one axis over a whole experiment, and when it left 1 kN and its limits, ∞ if never [s].

    Each stretch is one checkpoint of the reverse mode, so that gradients need the memory of √steps states.
    """
    judged, episode = signals.late is not None, AxisEpisode()
    lane = AxisLane(gains, contact, lsb, force_limit, swing.high_pass(contact.T_s, ops) if judged else None)

    def one(state: AxisProgress, now: AxisSignals) -> tuple[AxisProgress, None]:
        return episode.step(lane, state, episode.taken_apart(now), ops)[0], None

    @jax.checkpoint
    def stretch(state: AxisProgress, part: AxisSignals) -> tuple[AxisProgress, None]:
        return episode.fold(lane, jax.lax.scan(jax.checkpoint(one), state, part)[0], ops), None

    state, _ = over_stretches(stretch, episode.begin(lane, ops), signals)
    sums, extremes, diverged, over_limit = episode.found(state)
    late = jnp.sum(signals.late) if judged else None
    joints = no_joints(0.0 * gains.mpc_u)
    found = metrics(sums, extremes, jnp.sum(signals.score), len(signals.heart), late, joints, ops)
    return found, diverged, over_limit


def over_stretches(stretch: Callable[..., Any], state: Any, signals: Any) -> tuple[Any, list[Any]]:
    """Scan whole stretches of time, then what is left of it.

    Args:
        stretch: f(state, signals of a stretch) → state, what is kept.
        state: At the beginning.
        signals: With the steps as leading dimension.

    Returns:
        The state at the end, and what was kept, each part with the stretches as leading dimension.
    """
    steps = len(jax.tree.leaves(signals)[0])
    whole, kept = steps - steps % STRETCH, []
    if whole:
        parts = jax.tree.map(lambda signal: signal[:whole].reshape(-1, STRETCH, *signal.shape[1:]), signals)
        state, found = jax.lax.scan(stretch, state, parts)
        kept.append(found)
    if whole < steps:
        state, found = stretch(state, jax.tree.map(lambda signal: signal[whole:], signals))
        kept.append(jax.tree.map(lambda leaf: leaf[None], found))
    return state, kept


def record(gains: Gains, contact: Contact, lsb: Any, signals: AxisSignals) -> Sample:
    """Every sample of one axis over a whole experiment, each field of shape (steps, …)."""

    def one(carry: LinearCarry, now: AxisSignals) -> tuple[LinearCarry, Sample]:
        following, sample = advance(gains, contact, lsb, carry, AxisEpisode().taken_apart(now), ops)
        return following, sample._replace(force_ref=now.force_ref)

    return jax.lax.scan(one, start(gains), signals)[1]
