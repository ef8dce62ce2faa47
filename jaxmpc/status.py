"""How a controller fared: a batch never raises, each row says it in one of these."""

import enum


class Status(enum.IntEnum):
    """Outcome of one controller on one tissue."""

    OK = 0
    UNSTABLE = 1
    DIVERGED = 2
    ILL_POSED = 3
    LOST_CONTACT = 4
    FORCE_LIMIT = 5

    @property
    def sentence(self) -> str:
        """What it means, for a person."""
        return {
            Status.OK: "stable, and the run stayed finite",
            Status.UNSTABLE: "the linear loop has a pole on or outside the unit circle",
            Status.DIVERGED: "the run left the finite numbers or 1 kN",
            Status.FORCE_LIMIT: "the residual left 20 N, or the measured force its limit",
            Status.LOST_CONTACT: "the tip left the tissue",
            Status.ILL_POSED: "the Riccati equation of the observer has no usable solution",
        }[self]
