r"""Takes the loop's gain back while the force swings faster than a heart can.

What swings faster than a heart, and more than what is as slow as one, is the loop's own doing: a tissue or a cable that
it was not designed for. With the force error ε = y − F_d, its second-order high-pass h and low-pass l, their mean
squares s² and ℓ² over the axes, and the limit S

    s²ₖ = s²ₖ₋₁ + α (Σ hₖ² − s²ₖ₋₁),  ℓ² likewise of l,   e = (s²/(S² + ℓ²))⁴
    gₖ = g_min + (gₖ₋₁ − g_min)(1 − r e/(1 + e)) + β (1 − gₖ₋₁)

and the cascades then believe in a tissue of stiffness K̂_s/g (`cascade.with_gain`), which scales their gain by g and
moves no state: nothing jumps. Far below the limit nothing happens, and the loop keeps its margins; where the gain had
to fall, it comes back slowly until the force begins to swing again. Without ℓ the error that a low gain leaves would
hold the gain down. A gain that falls below the loop's reduction margin makes it swing slowly, which this cannot see.
"""

from typing import Annotated, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Constant, Scalar, Vector, sub

CORNER = 75.0
"""Corner of both filters' stages, 12 Hz [rad/s]: a heart's motion has ended, the modes of cables begin at 15 Hz."""
MEMORY = 0.02
"""Time constant of the mean squares [s]."""
LIMIT = 0.3
"""S, root mean square of a swing about no slow error at which the gain falls half as fast as it can [N]. Arrhythmia,
coughs and reversing friction reach 0.63 of S and ℓ with the text design, whose errors are large."""
PACE = 15.0
"""Fastest relative fall of the gain r/T_s [1/s]."""
RETURN = 10.0
"""Time constant with which it comes back [s]."""
LEAST = 0.1
"""g_min [-]."""


_SHARE = Constant(low=0.0, below=1.0)
"""Poles and shares of a sample: below 1, so that the gain stays above its least."""


class GainBackoff(NamedTuple):
    """Constants; each may be a batch."""

    corner: Annotated[Scalar, _SHARE]
    """Pole of each stage of the filters [-]."""
    forgetting: Annotated[Scalar, _SHARE]
    """α [-]"""
    sensitivity: Annotated[Scalar, Constant(low=1e-9)]
    """1/S² [1/N²]"""
    pace: Annotated[Scalar, _SHARE]
    """r [-]"""
    recovery: Annotated[Scalar, _SHARE]
    """β [-]"""


class BackoffState(NamedTuple):
    """What is remembered between two samples."""

    gain: Scalar
    """g [-]"""
    slow: Vector
    """What the first stage of the high-pass has taken off, per axis [N]."""
    slower: Vector
    """What the second has."""
    swing: Scalar
    """s² [N²]"""
    drift: Scalar
    """ℓ² [N²]"""


def constants(T_s: Scalar, ops: Ops) -> GainBackoff:
    """Constants for a sampling time [s]."""
    corner, memory = ops.exp(-CORNER * T_s), ops.exp(-T_s / MEMORY)
    return GainBackoff(corner, 1.0 - memory, 1.0 / LIMIT**2 + 0.0 * T_s, PACE * T_s, T_s / RETURN)


def init(zero: Scalar = 0.0) -> BackoffState:
    """Full gain, no error yet; numbers in the form of `zero`."""
    return BackoffState(1.0 + zero, (zero,) * 3, (zero,) * 3, zero, zero)


def step(guard: GainBackoff, state: BackoffState, error: Vector) -> BackoffState:
    """Advance by one sample.

    Args:
        guard: Constants.
        state: What `init` or the last `step` returned.
        error: Measured force less the wanted one, 3 scalars [N].
    """
    slow = _passed(guard.corner, state.slow, error)
    fast = sub(error, slow)
    slower = _passed(guard.corner, state.slower, fast)
    swing = state.swing + guard.forgetting * (_square(sub(fast, slower)) - state.swing)
    # Two high-passes 1 − P have taken off P and P (1 − P): their difference is the low-pass P².
    drift = state.drift + guard.forgetting * (_square(sub(slow, slower)) - state.drift)
    share = guard.sensitivity * swing / (1.0 + guard.sensitivity * drift)
    # e/(1 + e) from its root's, so that no power of a force that runs away overflows.
    root = share * share / (1.0 + share * share)
    fall = guard.pace * root * root / (1.0 - 2.0 * root * (1.0 - root))
    gain = LEAST + (state.gain - LEAST) * (1.0 - fall) + guard.recovery * (1.0 - state.gain)
    return BackoffState(gain, slow, slower, swing, drift)


def _passed(pole: Scalar, state: Vector, value: Vector) -> Vector:
    return tuple(new + pole * (old - new) for new, old in zip(value, state, strict=True))


def _square(value: Vector) -> Scalar:
    x, y, z = value
    return x * x + y * y + z * z
