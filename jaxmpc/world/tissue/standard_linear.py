"""A spring of which a part relaxes, in two branches.

y = K_s (d − Σᵢ ½ s zᵢ),  żᵢ = (d − zᵢ) / τᵢ,  so K_∞ = (1 − s) K_s
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxmpc.world.tissue.base import (
    WIDTH,
    Axes,
    Memory,
    Scalar,
    Tissue,
    TissueConstant,
    TissueLaw,
    smooth_part,
    touched_springs,
)


class TissueState(NamedTuple):
    """What the standard linear solid remembers; held as lengths, it outlives a change of stiffness."""

    z_1: Axes
    """Dashpot of the fast branch, X, Y, Z [m]."""
    z_2: Axes
    """Dashpot of the slow branch, X, Y, Z [m]."""


class StandardLinear(TissueLaw):
    """The standard linear solid: relaxing is s [-], half in each branch, time_constants are τ₁ and τ₂ [s]."""

    name = "standard-linear"
    parameters = (
        TissueConstant("relaxing", 0.25, 0.0, 0.95),
        TissueConstant("time_constants", (0.1, 1.0), 1e-6, 3600.0),
    )

    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.held`."""
        along = self._along(tissue, memory)
        return along(0, d[0], ddot[0]), along(1, d[1], ddot[1]), along(2, d[2], ddot[2])

    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """See `TissueLaw.touched`."""
        return touched_springs(self._along(tissue, memory), tissue.stiffness, d, ddot, ops)

    def init(self, like: Scalar = 0.0) -> Memory:
        """See `TissueLaw.init`."""
        zero = 0.0 * like
        return TissueState((zero, zero, zero), (zero, zero, zero))

    def relax(
        self,
        attached: bool,
        tissue: Tissue,
        memory: Memory,
        d: Sequence[Scalar],
        ddot: Sequence[Scalar],
        h: Scalar,
        ops: Any,
    ) -> Memory:
        """State advanced by h, exact on a steady ramp and otherwise second order, stable at any h.

        With q = h / τ and e⁻q ≈ 1 / (1 + q + q²/2), for a tissue displaced from r₀ to r₁ meanwhile:

            z⁺ = (z + ½q r₀ + ½(q + q²) r₁) / (1 + q + ½q²)

        a weighted mean, so z never leaves the range of what it has followed. Without contact it returns to 0.
        Arguments are those of `TissueLaw.relax`.
        """
        begin, end = (d[0], d[1], d[2]), (d[0] + h * ddot[0], d[1] + h * ddot[1], d[2] + h * ddot[2])
        if not attached:
            begin, end = _surface(begin, ops), _surface(end, ops)
        _, (tau_1, tau_2) = self.constants(tissue)
        return TissueState(_follow(memory.z_1, begin, end, h / tau_1), _follow(memory.z_2, begin, end, h / tau_2))

    def _along(self, tissue: Tissue, memory: TissueState) -> Callable[[int, Scalar, Scalar], Scalar]:
        s, _ = self.constants(tissue)
        z_1, z_2 = memory
        return lambda axis, d, rate: tissue.stiffness * (d - 0.5 * s * (z_1[axis] + z_2[axis]))


def _follow(z: Axes, begin: Axes, end: Axes, q: Scalar) -> Axes:
    first, second = 0.5 * q, 0.5 * (q + q * q)
    scale = 1.0 / (1.0 + first + second)
    x, y, z_ = ((z[i] + first * begin[i] + second * end[i]) * scale for i in range(3))
    return x, y, z_


def _surface(d: Axes, ops: Any) -> Axes:
    """Displacement of the tissue's surface where the tip merely touches [m]."""
    depth, contact = smooth_part(-d[2], WIDTH, ops)
    return contact * d[0], contact * d[1], -depth
