"""Where a wanted force comes from: a constant, a table over time, or lines that arrive while the arm moves."""

import math
import os
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from jaxmpc.law.vectors import Vector3

_LONGEST_LINE = 200


class Source(Protocol):
    """Something that wants a force."""

    def wanted(self, t: float) -> Vector3:
        """Force on the tissue [N] wanted at a time since contact [s]."""

    def notes(self) -> list[str]:
        """What there is to say of it at the end of a run."""


@dataclass(frozen=True)
class ConstantForce:
    """The same force for ever."""

    force: Vector3

    def wanted(self, t: float) -> Vector3:
        """Force on the tissue [N] wanted at a time since contact [s]."""
        return self.force

    def notes(self) -> list[str]:
        """Nothing."""
        return []


class ForceTable:
    """Force at given times, straight lines between them; before the first and after the last it is held."""

    def __init__(self, times: Sequence[float], forces: Sequence[Vector3], name: str = "reference") -> None:
        """Take rows with increasing times [s] and finite forces [N]."""
        self._times, self._forces, self._name = tuple(times), tuple(forces), name
        self._row = 0
        self._ended = False

    def wanted(self, t: float) -> Vector3:
        """Force on the tissue [N] wanted at a time since contact [s]."""
        times, forces = self._times, self._forces
        if t >= times[-1]:
            self._ended = True
            return forces[-1]
        if t <= times[0]:
            return forces[0]
        row = self._row if times[self._row] <= t else 0  # asked for in order, so the search goes on where it was
        while times[row + 1] <= t:
            row += 1
        self._row = row
        share = (t - times[row]) / (times[row + 1] - times[row])
        (ax, ay, az), (bx, by, bz) = forces[row], forces[row + 1]
        return ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az)

    def notes(self) -> list[str]:
        """Whether it came to its end."""
        held = f"{self._name}: ended at {self._times[-1]:g} s, its last force was held"
        return [held] if self._ended and len(self._times) > 1 else []


class Lines:
    """The last valid line of a stream of lines `x y z` [N], read by a thread; at the end it is held."""

    def __init__(self, descriptor: int, start: Vector3, largest: float) -> None:
        """Start reading.

        Args:
            descriptor: Of an open file, as `sys.stdin.fileno()`.
            start: Wanted until the first valid line [N].
            largest: Lines with a greater magnitude are refused [N].
        """
        self._force, self._largest = start, largest
        self.lines = self.refused = 0
        self._first_refused = ""
        self._ended = False
        self._descriptor = descriptor
        threading.Thread(target=self._work, name="reference", daemon=True).start()

    def wanted(self, t: float) -> Vector3:
        """Force on the tissue [N] wanted now."""
        return self._force

    def notes(self) -> list[str]:
        """Lines taken and refused, and whether the stream has ended."""
        notes = [f"reference: {self.lines} lines taken"]
        if self.refused:
            notes += [f"reference: {self.refused} lines refused, the first was {self._first_refused}"]
        return [*notes, "reference: its stream has ended, the last force was held"] if self._ended else notes

    def _work(self) -> None:
        left, too_long = b"", False
        while True:
            try:
                chunk = os.read(self._descriptor, 4096)
            except OSError:
                chunk = b""
            if not chunk:
                break
            *whole, left = (left + chunk).split(b"\n")
            if too_long and whole:
                del whole[0]  # the end of a line that was refused before
                too_long = False
            if not too_long and len(left) > _LONGEST_LINE:
                self._refuse(left)
                too_long = True
            left = b"" if too_long else left
            for line in whole:
                self._take(line)
            time.sleep(0.001)  # a stream that never pauses must not keep the loop from running
        self._take(left)
        self._ended = True

    def _take(self, line: bytes) -> None:
        if not line.split():
            return
        words = line.split(b",") if b"," in line else line.split()  # no cell of a row may be missing
        try:
            x, y, z = map(float, words)
        except ValueError:
            return self._refuse(line)
        # NaN is not below anything; to Python 1_0 is ten.
        if len(line) > _LONGEST_LINE or b"_" in line or not math.hypot(x, y, z) <= self._largest:
            return self._refuse(line)
        self._force = (x, y, z)
        self.lines += 1
        return None

    def _refuse(self, line: bytes) -> None:
        self.refused += 1
        self._first_refused = self._first_refused or repr(line[:40].decode("ascii", "replace"))
