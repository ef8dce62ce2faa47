"""A spring beside a damper: y = K_s d + b ḋ."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import Axes, Memory, Scalar, Tissue, TissueConstant, TissueLaw, touched_springs


class KelvinVoigt(TissueLaw):
    """A spring and a damper along each axis; viscosity is b [N s/m], and above 3 it flatters the phase margin."""

    name = "kelvin-voigt"
    parameters = (TissueConstant("viscosity", 3.0, 0.0, 100.0),)

    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.held`."""
        (b,) = self.constants(tissue)
        x, y, z = (tissue.stiffness * d[i] + b * ddot[i] for i in range(3))
        return x, y, z

    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.touched`."""
        K_s, (b,) = tissue.stiffness, self.constants(tissue)
        return touched_springs(lambda axis, x, rate: K_s * x + b * rate, K_s, d, ddot, ops)
