"""The closed loop over time as a scan: law, world, imperfections and metrics of one axis, step by step."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.law import cascade
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics, Totals, add, merge, metrics, nothing
from jaxmpc.world import contact as world
from jaxmpc.world.contact import Contact
from jaxmpc.xla import ops

Scalar = Float[Array, ""]

STRETCH = 125
"""Samples between two checkpoints of the reverse mode and two partial sums of the metrics."""


HIGHEST_FORCE = 1e3
"""A run whose force leaves this has diverged [N]."""


class AxisSignals(NamedTuple):
    """What one axis meets, sample by sample."""

    heart: Float[Array, " steps"]
    noise: Float[Array, " steps"]
    force_ref: Float[Array, "steps ahead"]
    score: Array
    acceleration: Float[Array, " steps"] | None = None
    """Acceleration of the tip by what else acts on it, such as friction [m/s²]; None costs nothing."""


class Sample(NamedTuple):
    """What a recorded run keeps of one sample."""

    force: Scalar
    """Measured force [N]."""
    force_ref: Array
    """Wanted force: what the controller was told, one value or H_p of them [N]."""
    u: Scalar
    """MPC output [N]."""
    v: Scalar
    """Command of the cascade [m/s²]."""
    a: Scalar
    """Acceleration asked of the robot [m/s²]."""
    p_hat: Scalar
    """Estimated disturbance [m/s²]."""
    tip: Scalar
    """Tip position [m]."""


class LinearCarry(NamedTuple):
    """State of the whole loop between two samples."""

    controller: cascade.AxisState
    contact: world.ContactState


def scalars(gains: Gains, preview: bool) -> Gains:
    """Gains with every vector taken apart into scalars, as the law's inner loop wants them."""
    numbers = {name: value for name, value in gains._asdict().items() if name != "guard"}
    vectors: dict[str, Any] = {name: tuple(value) for name, value in numbers.items() if jnp.ndim(value) == 1}
    apart = gains._replace(**vectors)
    summed: Gains = apart if preview else apart._replace(mpc_ref=(jnp.sum(gains.mpc_ref),))
    return summed


def start(gains: Gains) -> LinearCarry:
    """The loop at rest: the tip touches without force."""
    zero = jnp.zeros_like(gains.mpc_u)
    return LinearCarry(cascade.init(zero, cascade.order(gains)), world.init(zero))


def advance(
    gains: Gains, contact: Contact, lsb: Scalar, carry: LinearCarry, signals: AxisSignals
) -> tuple[LinearCarry, Sample]:
    """One sample of the closed loop.

    Args:
        gains: The controller, taken apart by `scalars`.
        contact: The world.
        lsb: Quantisation of the force sensor [N]; 0 is none.
        carry: State.
        signals: What is met at this sample.
    """
    clean, state = world.sense(contact, carry.contact, signals.heart)
    noisy = clean + signals.noise
    quantised = world.quantise(noisy, jnp.where(lsb > 0.0, lsb, 1.0), ops.floor)
    force = jnp.where(lsb > 0.0, quantised, noisy)
    controller, v = cascade.step(gains, carry.controller, force, tuple(signals.force_ref))
    tip = state.x
    state, a = world.move(contact, state, v, signals.acceleration)
    sample = Sample(force, signals.force_ref, controller.u, v, a, controller.p_hat, tip)
    return LinearCarry(controller, state), sample


def run(gains: Gains, contact: Contact, lsb: Scalar, signals: AxisSignals) -> tuple[Metrics, Scalar]:
    """Metrics of one axis over a whole experiment, and when its force left 1 kN, ∞ if never [s].

    Time runs in stretches: each is one checkpoint of the reverse mode and one partial sum, so that
    gradients need the memory of √steps states and float32 sums keep their digits.
    """
    steps = len(signals.heart)
    full = -(-steps // STRETCH) * STRETCH

    def stretches(signal: Array) -> Array:
        padded = jnp.pad(signal, [(0, full - steps)] + [(0, 0)] * (signal.ndim - 1))
        return padded.reshape(-1, STRETCH, *signal.shape[1:])

    def one(state: tuple[LinearCarry, Totals], now: AxisSignals) -> tuple[tuple[LinearCarry, Totals], None]:
        carry, totals = state
        following, sample = advance(gains, contact, lsb, carry, now)
        error, before = sample.force - now.force_ref[0], carry.contact.pending[0]
        totals = add(totals, now.score, error, sample.a, sample.a - before, sample.force)
        return (following, totals), None

    @jax.checkpoint
    def stretch(state: tuple[LinearCarry, Totals], part: AxisSignals) -> tuple[tuple[LinearCarry, Totals], Any]:
        carry, totals = state
        (carry, partial), _ = jax.lax.scan(jax.checkpoint(one), (carry, empty), part)
        return (carry, merge(totals, partial)), ~(partial.highest_force < HIGHEST_FORCE)

    empty = nothing(jnp.zeros_like(gains.mpc_u))
    parts = jax.tree.map(stretches, signals)
    (_, totals), away = jax.lax.scan(stretch, (start(gains), empty), parts)
    # To one stretch: a flag per sample would cost every run what only a lost one needs.
    when = jnp.where(jnp.any(away), STRETCH * jnp.argmax(away) * contact.T_s, jnp.inf)
    return metrics(totals, jnp.sum(signals.score)), when


def record(gains: Gains, contact: Contact, lsb: Scalar, signals: AxisSignals) -> Sample:
    """Every sample of one axis over a whole experiment, each field of shape (steps, …)."""
    _, samples = jax.lax.scan(lambda carry, now: advance(gains, contact, lsb, carry, now), start(gains), signals)
    return samples
