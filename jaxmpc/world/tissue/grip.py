"""Where the tip sticks on a tissue that it merely touches.

Along the surface a touched tissue is a spring from a point a that moves with it. In contact the point stays; where the
tip lifts off it follows, so that contact regained elsewhere begins without a force along the surface. With the share of
contact p′ of `smooth_part`, at the displacement d reached in h,

    a⁺ = (p′ T a + h (1 − p′) d) / (p′ T + h (1 − p′)),   T = 1 ms

which has no kink and any h bears: a tip that presses by millimetres holds for hours, one that hardly touches slides.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxmpc.world.tissue.base import WIDTH, Axes, Memory, Scalar, smooth_part

SLIDING = 1e-3
"""T [s]."""


class Touched(NamedTuple):
    """What a merely touched tissue remembers."""

    anchor: tuple[Scalar, Scalar]
    """a, from where the tip touched first, X and Y [m]."""
    law: Memory
    """What its law does."""


def from_anchor(anchor: tuple[Scalar, Scalar], d: Sequence[Scalar]) -> Axes:
    """Displacement from where the tip sticks [m]; of the same depth."""
    return d[0] - anchor[0], d[1] - anchor[1], d[2]


def followed(
    anchor: tuple[Scalar, Scalar], d: Sequence[Scalar], ddot: Sequence[Scalar], h: Scalar, ops: Any
) -> tuple[Scalar, Scalar]:
    """a, h later; arguments as of `TissueLaw.relax`."""
    contact = smooth_part(-(d[2] + h * ddot[2]), WIDTH, ops)[1]
    stays, goes = contact * SLIDING, h * (1.0 - contact)
    x, y = ((stays * a + goes * (d[i] + h * ddot[i])) / (stays + goes) for i, a in enumerate(anchor))
    return x, y
