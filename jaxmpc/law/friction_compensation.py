"""Friction that the controller cancels, from a nominal model of it: Dahl's bristles on the measured angles.

A sign of the velocity would be late by the velocity's filter and would shake with the encoder's counts wherever the
motion turns; there friction is presliding, which depends on the angle, and the angle is measured without a filter:

    s⁺ = (s + Δq/z) / (1 + |Δq|/z),   τ_f = F_c s⁺ + D q̇

with the deflection s of a bristle over its largest, the change Δq of a joint's angle since the last sample, the
presliding displacement z, Coulomb friction F_c and viscous friction D.

Source: Dahl, The Aerospace Corporation TOR-0158(3107-18)-1, 1968, with exponent 1.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, add, sub

LEAST = 1e-7
"""Change of an angle below which its size is rounded off, far below a count of the encoder [rad]."""


class NominalFriction(NamedTuple):
    """The friction that is cancelled; each scalar may be a batch."""

    coulomb: Vector
    """F_c of the joints [N m]."""
    viscous: Vector
    """D [N m s/rad]."""
    presliding: Scalar
    """z [rad]."""


class Bristles(NamedTuple):
    """What is remembered between two samples, per joint."""

    deflection: Vector
    """s [-]"""
    angle: Vector
    """Measured angle of the last sample [rad]."""


def init(angle: Vector) -> Bristles:
    """Bristles at rest at measured angles [rad]."""
    return Bristles(tuple(0.0 * joint for joint in angle), angle)


def step(nominal: NominalFriction, state: Bristles, q: Vector, qd: Vector, ops: Ops) -> tuple[Bristles, Vector]:
    """Advance by one sample.

    Args:
        nominal: Constants.
        state: What `init` or the last `step` returned.
        q: Measured joint angles, 4 scalars [rad].
        qd: Measured joint velocities, 4 scalars [rad/s].
        ops: Scalar functions.

    Returns:
        The next state, and the joint torques that cancel the friction [N m].
    """
    slid = sub(q, state.angle)
    s = tuple(bristle(*joint, LEAST, nominal.presliding, ops) for joint in zip(state.deflection, slid, strict=True))
    return Bristles(s, q), add(_times(nominal.coulomb, s), _times(nominal.viscous, qd))


def bristle(s: Scalar, slid: Scalar, least: Scalar, z: Scalar, ops: Ops) -> Scalar:
    """Next deflection of one bristle [-], implicit in it and so within [−1, 1] however far it slid.

    Args:
        s: Deflection over its largest [-].
        slid: How far the joint moved [rad].
        least: Below which the size of that is rounded off [rad].
        z: Presliding displacement [rad].
        ops: Scalar functions.
    """
    return (s * z + slid) / (z + ops.sqrt(slid * slid + least * least))


def _times(one: Sequence[Scalar], other: Sequence[Scalar]) -> Vector:
    return tuple(a * b for a, b in zip(one, other, strict=True))
