"""Tissue that stiffens as it is pressed: −y_z = a (exp(β δ) − 1), in X and Y the spring K_s."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import SECANT_FORCE, WIDTH, Axes, Memory, Scalar, Tissue, TissueLaw, smooth_part

EXPONENT = 1.543
"""β δ at 5 N: tangents of 0.42 and 1.96 K_s at 0 and 5 N, 340 and 1590 N/m on a heart of 810 N/m [-]."""
SCALE = 1.3592109
"""a, the 5 N over exp(1.543) − 1 [N]."""


class Fung(TissueLaw):
    """Fung's exponential law."""

    name = "fung"

    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.held`."""
        K_s, delta = tissue.stiffness, -d[2]
        # Two one-sided exponentials meet at 0 with the same slope, and neither overflows on the other side.
        z = -_normal(tissue, ops.maximum(delta, 0.0), ops) + _normal(tissue, ops.maximum(-delta, 0.0), ops)
        return K_s * d[0], K_s * d[1], z

    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.touched`."""
        K_s = tissue.stiffness
        depth, contact = smooth_part(-d[2], WIDTH, ops)
        return contact * (K_s * d[0]), contact * (K_s * d[1]), -_normal(tissue, depth, ops)


def _normal(tissue: Tissue, delta: Scalar, ops: Any) -> Scalar:
    """a (exp(β δ) − 1) with β = 1.543 K_s / 5 N."""
    return SCALE * (ops.exp(EXPONENT / SECANT_FORCE * tissue.stiffness * delta) - 1.0)
