"""Posture at which a controller was made: near it its margins hold."""

from collections.abc import Sequence

NEAR = 0.3
"""Farthest that a joint may be from the controller's posture before the approach [rad]."""


def displaced(q: Sequence[float], posture: Sequence[float]) -> str:
    """Where the first joint stands that is too far away, in words; empty if none is.

    Args:
        q: Joint angles (4,) [rad].
        posture: Those of the controller (4,) [rad].
    """
    for i, (angle, wanted) in enumerate(zip(q, posture, strict=True), start=1):
        if not abs(angle - wanted) <= NEAR:
            return f"joint {i} stands at {angle:.2f} rad, the controller was made for {wanted:.2f} ± {NEAR:g}"
    return ""
