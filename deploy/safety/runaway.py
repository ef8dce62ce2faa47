"""A loop that runs away: the acceleration that it asks of the tip is one that no heart has.

Whatever feeds a loop a force that is late, negative, or that of a tissue stiffer than promised, makes it swing or push
ever harder. That shows in what it asks for tens of milliseconds before the tip has the speed to do harm.
"""

from deploy.safety.reasons import Reason
from jaxmpc.law.vectors import Vector3

ASKED = 40.0
"""Acceleration of the tip [m/s²] that a loop which follows a heart never asks for: at most 22 was seen in clean runs,
as contact is made, and 7 later; hundreds where it swings."""
SAMPLES = 3
"""In a row."""


def runaway_step(count: int, asked: Vector3) -> tuple[int, Reason | None]:
    """Take a sample of contact.

    Args:
        count: What the last step returned; 0 at first.
        asked: Acceleration that the law asked of the tip in the last sample [m/s²].

    Returns:
        Samples in a row beyond the bound, and why contact must end, or None.
    """
    x, y, z = asked
    count = 0 if x * x + y * y + z * z <= ASKED * ASKED else count + 1  # so that NaN counts
    return count, Reason.FORCE_MODEL if count >= SAMPLES else None
