"""What came of trials, and the verdicts on them."""

from typing import NamedTuple

import numpy as np

from jaxmpc.status import Status

LARGEST_ERROR = 2.0
"""|e| from which on a trial is lost or left 2 N [N]."""
SWINGING = 0.1
"""RMS of the true force above 12 Hz from which on a trial swings [N]."""


class Outcomes(NamedTuple):
    """What happened; leading dimensions are trials and controllers."""

    status: np.ndarray
    """A `Status`: UNSTABLE where the linear loop of that tissue and delay is, whatever the arm's friction held."""
    when: np.ndarray
    """When that happened, or for a status of the linear loop when the run diverged; NaN where it did not [s]."""
    spectral_radius: np.ndarray
    """Spectral radius of the linear loop [-]."""
    backed_off: np.ndarray
    """When a guard took gain back; ∞ where it was at rest throughout, or there is none [s]."""
    rms: np.ndarray
    """RMS of the residual after 2 s, (trials, controllers, 3) [N]; NaN where the run diverged."""
    true_rms: np.ndarray
    """That of the force on the tissue itself, without what the sensor adds, the same [N]."""
    peak_error: np.ndarray
    """Largest |e| after 2 s, the same [N]."""
    swing: np.ndarray
    """True force above 12 Hz, RMS over the last 10 s, the same [N]."""
    whole_arm_unstable: np.ndarray
    """Whether the linear loop of the whole arm is unstable at full gain; asked only where |e| ≥ 2 N and status OK."""

    @property
    def swinging(self) -> np.ndarray:
        """Whether each trial swings at its end, (trials, controllers)."""
        found: np.ndarray = np.any(self.swing > SWINGING, axis=-1)
        return found

    @property
    def beyond(self) -> np.ndarray:
        """Whether |e| ≥ 2 N although the status is OK."""
        found: np.ndarray = (self.status == Status.OK) & np.any(self.peak_error >= LARGEST_ERROR, axis=-1)
        return found

    @property
    def lost(self) -> np.ndarray:
        """Whether each trial was lost."""
        lost: np.ndarray = (self.status != Status.OK) | self.beyond & (self.whole_arm_unstable | self.swinging)
        return lost

    @property
    def left(self) -> np.ndarray:
        """Whether an event pushed a stable loop to 2 N."""
        left: np.ndarray = self.beyond & ~self.lost
        return left

    @property
    def at_rest(self) -> np.ndarray:
        """Whether the guard left the gain above 0.99 throughout."""
        resting: np.ndarray = np.isinf(self.backed_off)
        return resting
