"""What of a sweep is left to do, offered piece by piece to whoever computes; other processes may take from it too."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxmpc.files.errors import InputError, counted
from sweeps import chunks
from sweeps.leases import Leases, Stretch
from sweeps.plan import Plan

PATIENCE = 0.25
"""Between two looks at what others are doing [s]."""


def check_part(part: tuple[int, int]) -> tuple[int, int]:
    """k and n of the k-th of n parts.

    Raises:
        InputError: There is no such part.
    """
    remedy = "Write (2, 3) for the second of three."
    try:
        k, n = part
    except (TypeError, ValueError):
        raise InputError("part", part, "two numbers, k and n", remedy) from None
    n = counted("part", n, remedy)
    return counted("part", k, f"Parts count from 1 to {n}.", 1, n), n


class Share:
    """The missing rows of a folder, in stretches that fit together with those of others.

    Args:
        folder: The sweep's.
        plan: What is swept.
        there: Whether each planned row is there.
        leases: Who works on what.
        part: k and n: begin with the k-th of n equal parts, then help with the others.
    """

    def __init__(self, folder: Path, plan: Plan, there: np.ndarray, leases: Leases, part: tuple[int, int]) -> None:
        self._folder, self._plan, self._leases = folder, plan, leases
        self.there = there.copy()
        self._taken = there.copy()
        """There, given up, or in this process's hands."""
        self._known = {path.name for path in chunks.chunk_files(folder)}
        k, n = part
        self._cursor = len(there) * (k - 1) // n

    def next(self, length: int) -> Stretch | None:
        """A stretch that is now this process's; None where others have all that is left.

        Args:
            length: Most rows of it.

        Raises:
            OSError: The folder cannot be written.
        """
        self._look()
        free = ~self._taken
        for first, last in self._leases.others():
            free[first:last] = False
        while free.any():
            places = np.flatnonzero(free[self._cursor :])
            begin = self._cursor + int(places[0]) if len(places) else int(np.argmax(free))
            stretch = begin, self._end(free, begin, length)
            if self._leases.take(stretch):
                self._taken[slice(*stretch)] = True
                self._cursor = stretch[1] % len(free)
                # Somebody may have finished it since we looked.
                self._look()
                if not self.there[slice(*stretch)].any():
                    return stretch
                self.give_back(stretch)
                free = ~self._taken
                continue
            free[slice(*stretch)] = False
            self._mark_given_up()
        return None

    def finished(self) -> bool:
        """Whether every row is there or given up."""
        self._look()
        given_up = np.zeros_like(self.there)
        for first, last in self._leases.given_up():
            given_up[first:last] = True
        return bool((self.there | given_up).all())

    def wait(self, stop: Callable[[], bool]) -> None:
        """Let others work a little."""
        if not stop():
            time.sleep(PATIENCE)

    def done(self, stretch: Stretch) -> None:
        """A stretch of this process's has been written."""
        self.there[slice(*stretch)] = True
        self._known.add(f"{chunks.chunk_name(*stretch)}.npz")

    def give_back(self, stretch: Stretch) -> None:
        """Another may have what is left of a stretch."""
        self._leases.release(stretch)
        part = slice(*stretch)
        self._taken[part] = self.there[part]

    def _end(self, free: np.ndarray, begin: int, length: int) -> int:
        """Where a stretch ends: at what is not free, and if it can at the end of a world."""
        most = min(begin + length, len(free))
        taken = np.flatnonzero(~free[begin:most])
        end = begin + int(taken[0]) if len(taken) else most
        bounds = self._plan.bounds
        inside = bounds[np.searchsorted(bounds, begin, "right") : np.searchsorted(bounds, end, "right")]
        return int(inside[-1]) if len(inside) else end

    def _look(self) -> None:
        """What others have written since."""
        for path in chunks.chunk_files(self._folder):
            if path.name not in self._known and (stretch := chunks.stretch_of(path.name)):
                self._known.add(path.name)
                self.there[slice(*stretch)] = True
                self._taken[slice(*stretch)] = True
        self._mark_given_up()

    def _mark_given_up(self) -> None:
        for first, last in self._leases.given_up():
            self._taken[first:last] = True
