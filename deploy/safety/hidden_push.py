r"""The push that the sensor does not tell, with friction told apart by the way the tip goes.

What the motors tell beyond the reading is a push that is hidden, gravity's error, and friction, which turns with the
direction of motion. A beating heart moves the tip either way, several times a second; over the last seconds

    d = b + c s,   s = tanh(v / v₀), as slow as d          least squares, with a memory of τ

gives friction c by itself. In the air, on the way down, dₐ = bₐ + c sₐ with nothing hidden; so

    hidden = b − (dₐ − c sₐ)

is left without friction and without gravity's error: half a newton wrong where a single moment's d is wrong by two.
"""

from typing import NamedTuple

SLOW = 0.003
"""v₀, speed of the tip at which friction is nearly all there [m/s]."""
MEMORY = 1.0
"""τ [s]."""
FILLED = 0.75
"""Share of the memory that must be filled before anything is told: 1.4 s of contact."""
TURNING = 0.1
"""Variance of s that tells friction from push [-]: 0.3 is the least of a heart's rhythms, 0 a tissue's at rest."""


class MotionSums(NamedTuple):
    """Sums over contact, older samples weighing less."""

    weight: float = 0.0
    s: float = 0.0
    ss: float = 0.0
    d: float = 0.0
    """[N]"""
    sd: float = 0.0
    """[N]"""


def gathered(sums: MotionSums, slip: float, push: float, T_s: float) -> MotionSums:
    """Sums with a sample more.

    Args:
        sums: Those before.
        slip: s [-].
        push: d, what the motors tell beyond the reading [N].
        T_s: Sampling time [s].
    """
    new = T_s / MEMORY
    sample = (1.0, slip, slip * slip, push, slip * push)
    return MotionSums(*(old + new * (each - old) for old, each in zip(sums, sample, strict=True)))


def hidden_push(sums: MotionSums, air_slip: float, air_push: float) -> float | None:
    """Push that the sensor does not tell [N]; None where too little is known.

    Args:
        sums: Of contact.
        air_slip: Mean of s in the air, on the way down [-].
        air_push: Mean of d there [N].
    """
    weight, s, ss, d, sd = sums
    spread = weight * ss - s * s
    if weight < FILLED or spread < TURNING * weight * weight:
        return None
    friction = (weight * sd - s * d) / spread
    return (d - friction * s) / weight - (air_push - friction * air_slip)
