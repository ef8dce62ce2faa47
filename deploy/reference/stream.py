"""Wanted force over time, as a stream that nothing can make jump.

A source says which force is wanted at a time; `Stream` follows it, limited in magnitude and in rate. With preview
it hands out the next H samples, too: what a source without a future asks for then acts H samples later.
"""

import math
from collections import deque

from deploy.reference.sources import Source
from jaxmpc.files.errors import InputError
from jaxmpc.law.vectors import Vector3

RATE, LARGEST = 5.0, 10.0
"""Largest rate [N/s] and magnitude [N] of a wanted force, unless the caller gives others."""
_CATCH_UP = 3
"""Samples that the force goes on at once after missed ones; more of them would be a jump."""


class Stream:
    """What the controller is given: a source, limited, sample by sample."""

    def __init__(
        self,
        source: Source,
        T_s: float,
        start: Vector3 = (0.0, 0.0, 0.0),
        *,
        rate: float = RATE,
        largest: float = LARGEST,
        ahead: int = 0,
    ) -> None:
        """Begin at a force.

        Args:
            source: What is wanted.
            T_s: Sampling time [s].
            start: Force at contact, from which the first sample goes on [N].
            rate: Largest change of the vector per time [N/s].
            largest: Largest magnitude [N].
            ahead: Samples of preview H; 0 for none.

        Raises:
            InputError: A limit is not positive and finite.
        """
        for key, value in (("rate", rate), ("largest", largest), ("T_s", T_s)):
            if not 0.0 < value < math.inf:
                raise InputError(key, value, "positive and finite", "It is what keeps the wanted force from jumping.")
        self._source, self._T_s, self._step, self._largest = source, T_s, rate * T_s, largest
        self._ahead = ahead
        self._force = start if math.isfinite(sum(start)) else (0.0, 0.0, 0.0)
        self._sample = 0
        self._axes = tuple(deque([value] * (1 + ahead), maxlen=1 + ahead) for value in self._force)
        for _ in range(ahead):
            self._advance()

    def at(self, t: float) -> Vector3 | tuple[tuple[float, ...], ...]:
        """Wanted force of the sample at a time since contact [s].

        Times do not go back. After missed samples it follows the source on, never faster than three samples at once.

        Returns:
            Force [N], 3 floats; with preview 3 × (1 + H), of this sample and the next H.
        """
        steps = round(t / self._T_s) + self._ahead - self._sample
        if steps > _CATCH_UP:
            self._sample += steps - _CATCH_UP
            steps = _CATCH_UP
        for _ in range(steps):
            self._advance()
        x, y, z = self._axes
        return (tuple(x), tuple(y), tuple(z)) if self._ahead else self._force

    def notes(self) -> list[str]:
        """What the source has to say."""
        return self._source.notes()

    def _advance(self) -> None:
        self._sample += 1
        x, y, z = self._source.wanted(self._sample * self._T_s)
        size = math.hypot(x, y, z)
        if not math.isfinite(size):
            x, y, z = self._force
        elif size > self._largest:
            share = self._largest / size
            x, y, z = share * x, share * y, share * z
        was_x, was_y, was_z = self._force
        dx, dy, dz = x - was_x, y - was_y, z - was_z
        change = math.hypot(dx, dy, dz)
        if change > self._step:
            share = self._step / change
            x, y, z = was_x + share * dx, was_y + share * dy, was_z + share * dz
        self._force = (x, y, z)
        for axis, value in zip(self._axes, self._force, strict=True):
            axis.append(value)
