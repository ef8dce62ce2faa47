"""A sphere pressed into tissue: −y_z = k δ^1.5 (1 + c δ̇), in X and Y the spring K_s."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import (
    SECANT_FORCE,
    WIDTH,
    Axes,
    Memory,
    Scalar,
    Tissue,
    TissueConstant,
    TissueLaw,
    smooth_part,
)

NO_FALL = 0.05
"""Factor 1 + c δ̇ below which the damping is let run out, so that it never pulls [-]."""


class HuntCrossley(TissueLaw):
    """Hertz's force with a damping that grows with it; dissipation is c [s/m]."""

    name = "hunt-crossley"
    parameters = (TissueConstant("dissipation", 0.5, 0.0, 10.0),)

    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.held`."""
        K_s = tissue.stiffness
        return K_s * d[0], K_s * d[1], -self._normal(tissue, -d[2], -ddot[2], ops)

    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.touched`."""
        K_s, (c,) = tissue.stiffness, self.constants(tissue)
        depth, contact = smooth_part(-d[2], WIDTH, ops)
        normal = self._normal(tissue, depth, 0.0, ops) * smooth_part(1.0 + c * -ddot[2], NO_FALL, ops)[0]
        return contact * (K_s * d[0]), contact * (K_s * d[1]), -normal

    def _normal(self, tissue: Tissue, delta: Scalar, deltadot: Scalar, ops: Any) -> Scalar:
        """k δ √r (1 + c u δ̇), odd in δ: k δ^1.5 outside w, a finite slope inside; u makes pulling damped too.

        k = 5 N / (5 N / K_s)^1.5 = K_s √(K_s / 5 N).
        """
        (c,) = self.constants(tissue)
        r = ops.sqrt(delta * delta + WIDTH * WIDTH)
        k = tissue.stiffness * ops.sqrt(tissue.stiffness / SECANT_FORCE)
        return k * delta * ops.sqrt(r) * (1.0 + c * (delta / r) * deltadot)
