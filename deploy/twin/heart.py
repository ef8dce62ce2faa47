"""The heart under the twin: the simulator's motion as a stream without end, computed a few milliseconds ahead."""

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.law.vectors import Vector3
from jaxmpc.world.heart.motion import Motion, prepared

BLOCK = 64
"""Points computed at once: few, so that no tick of a real-time twin is long."""
HORIZON = 600.0
"""Time for which beats are drawn beforehand [s]; beyond it they are drawn anew for twice as long."""


class TwinHeart:
    """Position and velocity of the heart's surface at successive instants."""

    def __init__(self, motion: Motion, step: float) -> None:
        """Prepare a motion.

        Args:
            motion: How the heart moves, as in an experiment.
            step: Time from one instant to the next [s].

        Raises:
            InputError: It is a recording that ends, or one that is unusable.
        """
        if motion.kind == "recording" and not motion.repeat:
            raise InputError(
                "motion.repeat", "false", "true for a twin", "A twin has no end: let the recording repeat."
            )
        self._motion, self._step = motion, step
        self._until, self._surface = HORIZON, prepared(motion, HORIZON)
        self._block, self._points = -1, [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]

    def at(self, instant: int) -> tuple[Vector3, Vector3]:
        """Displacement [m] and velocity [m/s] at an instant counted from 0."""
        block, within = divmod(instant, BLOCK)
        if block != self._block:
            self._block, self._points = block, self._computed(block)
        return self._points[within]

    def _computed(self, block: int) -> list[tuple[Vector3, Vector3]]:
        t = np.arange(block * BLOCK, (block + 1) * BLOCK) * self._step
        if t[-1] > self._until:
            self._until *= 2.0
            self._surface = prepared(self._motion, self._until)
        rows = zip(*(values.tolist() for values in self._surface(t)), strict=True)
        return [((x[0], x[1], x[2]), (v[0], v[1], v[2])) for x, v in rows]
