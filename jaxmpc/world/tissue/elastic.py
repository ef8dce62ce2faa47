"""The paper's tissue, a spring: y = K_s d."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import Axes, Memory, Scalar, Tissue, TissueLaw, touched_springs


class Elastic(TissueLaw):
    """A spring along each axis."""

    name = "elastic"

    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.held`."""
        K_s = tissue.stiffness
        return K_s * d[0], K_s * d[1], K_s * d[2]

    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.touched`."""
        K_s = tissue.stiffness
        return touched_springs(lambda axis, x, rate: K_s * x, K_s, d, ddot, ops)
