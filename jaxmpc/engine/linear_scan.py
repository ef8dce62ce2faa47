"""The linear loop over time as a scan, over every controller, stiffness and axis."""

from collections.abc import Callable
from math import inf
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxmpc import swing
from jaxmpc.law.gains import Gains
from jaxmpc.loop.linear import HIGHEST_ERROR, HIGHEST_FORCE, AxisSignals, LinearCarry, Sample, advance, start
from jaxmpc.metrics import Metrics, Totals, add, merge, metrics, no_joints, nothing
from jaxmpc.world.contact import Contact
from jaxmpc.xla import ops

STRETCH = 125
"""Samples between two checkpoints of the reverse mode and two partial sums of the metrics."""


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

    Time runs in stretches: each is one checkpoint of the reverse mode and one partial sum, so that
    gradients need the memory of √steps states and float32 sums keep their digits. A moment is told to one stretch: a
    flag per sample would cost every run what only a lost one needs.
    """

    def one(state: Any, now: AxisSignals) -> tuple[Any, None]:
        carry, passing, totals = state
        following, sample = advance(gains, contact, lsb, carry, at_one_sample(now), ops)
        wanted, before = sample.force_ref[0], carry.contact.pending[0]
        swinging: Any = 0.0
        if passing is not None:
            above, passing = swing.step(filtering, passing, sample.true_force)
            swinging = ops.where(now.late, above, 0.0)
        errors = sample.force - wanted, sample.true_force - wanted
        totals = add(totals, now.score, *errors, sample.a, sample.a - before, sample.force, swinging, ops)
        return (following, passing, totals), None

    @jax.checkpoint
    def stretch(state: Any, part: AxisSignals) -> tuple[Any, Any]:
        carry, passing, totals = state
        (carry, passing, partial), _ = jax.lax.scan(jax.checkpoint(one), (carry, passing, empty), part)
        within = (partial.highest_force < force_limit) & (partial.largest_error < HIGHEST_ERROR)
        return (carry, passing, merge(totals, partial, ops)), (~(partial.highest_force < HIGHEST_FORCE), ~within)

    def first(flags: Array) -> Array:
        return jnp.where(jnp.any(flags), STRETCH * jnp.argmax(flags) * contact.T_s, jnp.inf)

    zero = jnp.zeros_like(gains.mpc_u)
    empty, filtering = nothing(zero), swing.high_pass(contact.T_s, ops)
    judged = signals.late is not None
    begin: tuple[LinearCarry, Any, Totals] = start(gains), swing.rest(zero) if judged else None, empty
    (_, _, totals), flags = over_stretches(stretch, begin, signals)
    diverged, over = (jnp.concatenate(parts) for parts in zip(*flags, strict=True))
    late = jnp.sum(signals.late) if judged else None
    found = metrics(totals, jnp.sum(signals.score), len(signals.heart), late, no_joints(zero), ops)
    return found, first(diverged), first(over)


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
        following, sample = advance(gains, contact, lsb, carry, at_one_sample(now), ops)
        return following, sample._replace(force_ref=now.force_ref)

    return jax.lax.scan(one, start(gains), signals)[1]


def at_one_sample(now: AxisSignals) -> AxisSignals:
    """The signals of a sample as the step takes them: the reference ahead as scalars."""
    return now._replace(force_ref=tuple(now.force_ref))
