"""Joint friction with presliding: Dahl's bristle, as scalar arithmetic.

With s the bristle's deflection over its largest, z the presliding displacement and |v|_ε = √(v² + ε²):

    ṡ = (v − |v|_ε s) / z,   τ = F_c s

Reversals follow an exponential hysteresis of length z instead of a jump: near rest the joint is a spring F_c / z.
Viscous friction is separate: it is the joint damping of the arm's model.

Source: Dahl, The Aerospace Corporation TOR-0158(3107-18)-1, 1968, with exponent 1; smoothed by ε, not clipped.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxmpc.law.friction_compensation import bristle
from jaxmpc.law.scalar import Scalar, Vector

PRESLIDING = 1e-3
"""Presliding displacement z, an assumption: no source gives one [rad]."""
SMALL_VELOCITY = 1e-3
"""ε, below which |v| is rounded off [rad/s]; a bristle left alone forgets itself in z / ε, here 1 s."""


class Friction(NamedTuple):
    """Constants of the four joints."""

    coulomb: Sequence[Scalar]
    """Torque in steady sliding F_c, four [N m]."""
    presliding: Scalar | Sequence[Scalar] = PRESLIDING
    """Displacement z over which a reversal settles [rad]: four, or one for all."""


def init(like: Scalar = 0.0) -> Vector:
    """Four bristles at rest, in the form of `like`, a finite number or a batch."""
    zero = 0.0 * like
    return zero, zero, zero, zero


def step(friction: Friction, s: Sequence[Scalar], v: Sequence[Scalar], h: Scalar, ops: Any) -> tuple[Vector, Vector]:
    """Advance the bristles, implicitly in s, and so stable and within [−1, 1] at any h.

        s⁺ = (s + h v / z) / (1 + h |v|_ε / z),   τ = F_c s⁺

    Args:
        friction: Constants.
        s: Deflections, four [-].
        v: Joint velocities, four [rad/s].
        h: Time to advance [s].
        ops: Where `sqrt` is.

    Returns:
        The next deflections [-], and the friction torques [N m], which have the sign of the motion: subtract them.
    """
    z = friction.presliding
    each = isinstance(z, tuple | list) or getattr(z, "ndim", 0) > 0
    moved = [bristle(s[i], h * v[i], h * SMALL_VELOCITY, z[i] if each else z, ops) for i in range(4)]
    torque = [friction.coulomb[i] * moved[i] for i in range(4)]
    return (moved[0], moved[1], moved[2], moved[3]), (torque[0], torque[1], torque[2], torque[3])
