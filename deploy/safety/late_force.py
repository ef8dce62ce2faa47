"""Whether the measured force comes late: that breaks no limit, but takes the loop's delay margin and presses more.

A family's sine tells it within two seconds of contact (`deploy.runtime.force_lag`), when no reading looks wrong.
"""

from collections.abc import Iterable

from deploy.durations import cycles
from deploy.safety.reasons import Reason

LATE = 2.5e-3
"""Lag that no healthy sensor has [s], and as much as the delay margin of `family`: a sensor's own 500 Hz low-pass makes
0.3 ms. An arm whose cables give way below some 25 Hz looks the same."""
LASTING = 0.02
"""For so long [s]: the lag is a mean of seconds, whose samples are not new ones."""


def late_step(count: int, lags: Iterable[float], T_s: float) -> tuple[int, Reason | None]:
    """Take a sample of contact.

    Args:
        count: What the last step returned; 0 at first.
        lags: Of the force of each axis [s]; 0 where it cannot be told.
        T_s: Sampling time [s].

    Returns:
        Samples in a row in which the force was late on every axis, and why contact must end, or None.
    """
    count = count + 1 if min(lags) > LATE else 0
    return count, Reason.FORCE_MODEL if count >= cycles(LASTING, T_s) else None
