"""The wire between twin and host: how long frames take on it, and those that faults lose, delay, double or add."""

import heapq
from collections.abc import Iterable, Iterator, Sequence
from itertools import count

import numpy as np

from deploy.puck.frame import Frame
from deploy.twin.faults import Fault, Links

_FOREIGN = (0x600, 0x7F0)
"""Identifiers of a babbling node: none of the WAM's, and the lowest priority."""

_ONE_AT_ONCE = (0.0,)


class BusTiming:
    """Frames under way to the host, and those from it that are late."""

    def __init__(self, bit_rate: float, faults: Sequence[Fault], random: np.random.Generator) -> None:
        """An empty wire.

        Args:
            bit_rate: [bit/s]; 0 carries every frame at once.
            faults: Of which those of frames count.
            random: For those that act at random.
        """
        self._bit_rate, self._links = bit_rate, Links(faults, random)
        self._waiting: list[tuple[int, int, Frame]] = []
        self._delayed: list[tuple[int, int, Frame]] = []
        self._order, self._free = count(), 0

    def copies(self, targets: Sequence[str], now: float) -> Sequence[float]:
        """Delays of the copies of a frame that belongs to these targets [s], none if it is lost."""
        return self._links.copies(targets, now) if self._links else _ONE_AT_ONCE

    def post(self, frame: Frame, at: int) -> None:
        """Send a frame to the host at a time [ns]."""
        heapq.heappush(self._waiting, (self.carry(frame, at), next(self._order), frame))

    def carry(self, frame: Frame, at: int) -> int:
        """Time at which a frame sent at a time is over the wire [ns]; bits are stuffed as typically (wam.md §6)."""
        if not self._bit_rate:
            return at
        bits = 47 + 8 * len(frame.data) + (34 + 8 * len(frame.data) - 1) // 20
        self._free = max(self._free, at) + round(1e9 * bits / self._bit_rate)
        return self._free

    def delay(self, frame: Frame, at: int) -> None:
        """Have a frame of the host arrive at a time [ns]."""
        heapq.heappush(self._delayed, (at, next(self._order), frame))

    def delayed(self, until: int) -> Iterable[tuple[int, Frame]]:
        """Frames of the host that have arrived by a time, each with its own [ns]."""
        return self._delayed_by(until) if self._delayed else ()

    def _delayed_by(self, until: int) -> Iterator[tuple[int, Frame]]:
        while self._delayed and self._delayed[0][0] <= until:
            at, _, frame = heapq.heappop(self._delayed)
            yield at, frame

    def take(self, until: int) -> list[Frame]:
        """Frames that have arrived by a time [ns]."""
        due = []
        while self._waiting and self._waiting[0][0] <= until:
            due.append(heapq.heappop(self._waiting)[2])
        return due

    def next(self) -> int | None:
        """Arrival of the next frame in either direction [ns], None if none is under way."""
        coming = [queue[0][0] for queue in (self._waiting, self._delayed) if queue]
        return min(coming) if coming else None


class BabblingNode:
    """Foreign node that fills the bus while a fault of the word "babble" lasts."""

    def __init__(self, faults: Sequence[Fault], random: np.random.Generator) -> None:
        self._faults = [fault for fault in faults if fault.target == "bus" and fault.word == "babble"]
        self._random, self._due = random, 0.0

    def frames(self, now: float) -> Iterator[Frame]:
        """Frames of the millisecond that begins at a time [s]."""
        for fault in self._faults:
            if fault.active(now):
                self._due += 1e-3 * fault.value
                for _ in range(int(self._due)):
                    yield Frame(int(self._random.integers(*_FOREIGN)), self._random.bytes(8))
                self._due -= int(self._due)
