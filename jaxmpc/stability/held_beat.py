r"""What a controller that learns the beat is while the heart's rate stays: resonators beside the force it wants.

With s_n = c_n uⁿ the law of `jaxmpc.law.repetition` has no phase any more. The authority of the schedule is 1, the
heart is heard, no error is too large, and all that is learned is used, h = 1:

    s_n ← e^{jnωT_s} s_n − k_n e,   r = Σ h_n Re(s_n e^{jnωd}),   k_n = g_n ω h_n

with the share h_n of each harmonic, so that r = −R e behind the two low-passes of e, and at q = z⁻¹

    R = Σ h_n k_n (cos nωd − q cos nω(d − T_s))/(1 − 2 q cos nωT_s + q²)

With a part of it in use, h < 1, the resonators are damped and M_s is no larger. Rates that move are no matter of
margins but of trials.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxmpc.law.repetition import FADING, Repetition, share
from jaxmpc.stability.crossings import Poles
from jaxmpc.xla import ops


class HeldBeat(NamedTuple):
    """What is learned, and at which rate of the heart."""

    repetition: Repetition
    rate: Any
    """ω [rad/s]."""


class Resonators(NamedTuple):
    """State of the resonators."""

    error: Any
    """Behind one low-pass and behind two, (2,) [N]."""
    parts: Any
    """s_n, real and imaginary part, (N, 2) [N]."""


def spread_rates(repetition: Repetition, count: int) -> Any:
    """Rates of the heart, log-spaced over what it may have, (count,) [rad/s]; traceable."""
    return jnp.geomspace(repetition.finder.least, repetition.finder.most, count)


TELLING = (0.0, -0.25, 0.4)
"""Where the fastest harmonic stands at rates that tell, above where it begins to fade, over `FADING` [-]."""


def telling_rates(repetition: Repetition) -> Any:
    """The few rates at which margins are about least, (3,) [rad/s]; traceable.

    Most margins are where the fastest harmonic is as fast as one may be before it fades: of seven the fifth at 2.42 Hz.
    Gain reduction is least where one is a little slower, or hardly learned: the sixth at 1.94, the seventh at 1.83 Hz.
    """
    return rates_of(repetition, repetition.highest - FADING + FADING * jnp.array(TELLING))


def rates_of(repetition: Repetition, frequency: Any) -> Any:
    """Rates at which the three harmonics that are the first to fade have a frequency each [rad/s], (3,) [rad/s].

    Where that is beyond what a heart may have, the fastest rate of all.
    """
    whole, fastest = repetition.highest - FADING, repetition.finder.most
    harmonic = jnp.minimum(jnp.ceil(whole / fastest) + jnp.arange(3.0), len(repetition.gains))
    return jnp.clip(frequency / harmonic, repetition.finder.least, fastest)


def at_rates(repetition: Repetition, rates: Any, learns: Any = True) -> HeldBeat:
    """One controller's at rates of the heart, (1 + rates,); the first learns nothing.

    Args:
        repetition: Its constants.
        rates: The rates, (rates,) [rad/s].
        learns: Whether it learns at all.
    """
    count = len(rates)
    share = jnp.where(learns, jnp.append(0.0, jnp.ones(count)), 0.0)
    wide: Repetition = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (1 + count,)), repetition)
    return HeldBeat(wide._replace(gains=tuple(share * gain for gain in wide.gains)), jnp.append(rates[:1], rates))


def still(held: HeldBeat) -> Resonators:
    """Nothing learned."""
    zero = 0.0 * held.rate
    return Resonators(jnp.stack([zero, zero]), jnp.zeros((len(held.repetition.gains), 2)) + zero)


def step(held: HeldBeat, state: Resonators, error: Any) -> tuple[Resonators, Any]:
    """One sample: what is learned, and what is added to the wanted force [N]; linear in state and error."""
    smoothing = held.repetition.smoothing
    once = state.error[0] + smoothing * (error - state.error[0])
    twice = state.error[1] + smoothing * (once - state.error[1])
    frequency, learned, used = _harmonics(held)
    turn, lead = frequency * held.repetition.finder.T_s, frequency * held.repetition.lead
    # A harmonic that is not learned is no part of the loop.
    real, imaginary = jnp.where(learned > 0.0, state.parts.T, 0.0)
    real, imaginary = (
        real * jnp.cos(turn) - imaginary * jnp.sin(turn) - learned * twice,
        imaginary * jnp.cos(turn) + real * jnp.sin(turn),
    )
    added = jnp.sum(used * (real * jnp.cos(lead) - imaginary * jnp.sin(lead)))
    return Resonators(jnp.stack([once, twice]), jnp.stack([real, imaginary], axis=1)), added


def response(held: HeldBeat, q: Any) -> Any:
    """R with the low-passes, at q = z⁻¹ [-]."""
    frequency, learned, used = (each[:, None] for each in _harmonics(held))
    T_s, lead, smoothing = held.repetition.finder.T_s, held.repetition.lead, held.repetition.smoothing
    at = jnp.ravel(q)
    upper = jnp.cos(frequency * lead) - at * jnp.cos(frequency * (lead - T_s))
    lower = 1.0 - 2.0 * at * jnp.cos(frequency * T_s) + at * at
    low_pass = smoothing / (1.0 - (1.0 - smoothing) * at)
    return jnp.reshape(low_pass**2 * jnp.sum(learned * used * upper / lower, axis=0), jnp.shape(q))


def poles(held: HeldBeat) -> Poles:
    """What each harmonic that is learned does to the loop: |R| is about k_n h_n/(2 δ) at a distance of δ [rad]."""
    frequency, learned, used = _harmonics(held)
    return Poles(frequency * held.repetition.finder.T_s, 0.5 * learned * used)


def _harmonics(held: HeldBeat) -> tuple[Any, Any, Any]:
    """Frequencies nω [rad/s], k_n and h_n [-], each (N,)."""
    gains = jnp.stack(list(held.repetition.gains))
    frequency = held.rate * jnp.arange(1.0, len(gains) + 1.0)
    used = share(held.repetition, frequency, ops)
    return frequency, gains * held.rate * used, used
