r"""Swinging: what the force on the tissue does faster than any heart.

A Butterworth high-pass of fourth order at 12 Hz, made for samples by the bilinear transform with the corner kept, and
the RMS of what it lets pass over the last 10 s of a run, of which settling is left out. Each of its two sections is a
state-variable filter (Zavalishin, The Art of VA Filter Design, 2012, §4): with g = tan(π f T_s) and dampings r = 2
sin(π/8), 2 sin(3π/8)

    h = (x − (r + g) s₁ − s₂) / (1 + r g + g²),   b = g h + s₁,   l = g b + s₂,   s₁' = b + g h,   s₂' = l + g b

whose difference of large numbers, unlike that of a transfer function's coefficients, float32 can bear. Samples further
apart than 1/24 s hold nothing of 12 Hz: there nobody knows how the force swings, and all that is told of it is NaN.
"""

from math import nan, pi, sin
from typing import Any, NamedTuple

CORNER_HZ = 12.0
"""Above it no heart moves and no loop need follow."""
WINDOW = 10.0
"""How much of the end of a run is judged [s]."""
DAMPINGS = 2.0 * sin(0.125 * pi), 2.0 * sin(0.375 * pi)

Lane = Any


class HighPass(NamedTuple):
    """Constants of the filter."""

    g: Lane
    """tan(π f T_s) [-]."""
    shares: tuple[Lane, Lane]
    """1 / (1 + r g + g²) of each section [-]."""


Sections = tuple[tuple[Lane, Lane], ...]
"""s₁ and s₂ of each section [N]."""


def high_pass(T_s: Lane, ops: Any) -> HighPass:
    """The filter for a sampling time [s]."""
    g = _corner(T_s, ops)
    first, second = (1.0 / (1.0 + r * g + g * g) for r in DAMPINGS)
    return HighPass(g, (first, second))


def _corner(T_s: Lane, ops: Any) -> Lane:
    """tan(π f T_s) [-], NaN from where the corner is no frequency of the samples."""
    half = pi * CORNER_HZ * T_s
    return ops.where(half < 0.5 * pi, ops.sin(half) / ops.cos(half), nan)


def rest(zero: Lane) -> Sections:
    """A filter that has met nothing yet, its numbers in the form of `zero`."""
    return ((zero, zero),) * len(DAMPINGS)


def step(constants: HighPass, state: Sections, force: Lane) -> tuple[Lane, Sections]:
    """What passes of a force at a sample [N], and the filter moved on."""
    g, following = constants.g, []
    for r, share, (s1, s2) in zip(DAMPINGS, constants.shares, state, strict=True):
        force = (force - (r + g) * s1 - s2) * share
        rise = g * force
        band = rise + s1
        low = g * band
        following.append((band + rise, low + low + s2))
    return force, tuple(following)


def gain(theta: Any, T_s: Lane, ops: Any) -> Any:
    """|H| = 1/√(1 + (g / tan ½θ)⁸) at angles 0 < θ < π [-]."""
    half = 0.5 * theta
    ratio = _corner(T_s, ops) * ops.cos(half) / ops.sin(half)
    return 1.0 / ops.sqrt(1.0 + ratio**8)
