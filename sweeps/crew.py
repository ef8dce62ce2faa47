"""Who computes: this process, or others that it asks. The result is the same."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sweeps.blocks import padded
from sweeps.compiling import so_far
from sweeps.compute import begin, round_of
from sweeps.leases import Leases, Stretch
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan
from sweeps.share import Share

AHEAD = 2
"""Rounds that are begun before the first of them is fetched."""
Stop = Callable[[], bool]


class RowsFailedError(RuntimeError):
    """Rows could not be computed; the message says why."""


class ComputedChunk(NamedTuple):
    """What was made of a stretch, or of a part of it that fills a file."""

    stretch: Stretch
    """As it was taken."""
    first: int
    """Place of the first row."""
    last: int
    """Place behind the last row that was computed: before the end of the stretch where somebody wanted to stop."""
    columns: Columns | None
    """None where nothing could be computed, from the first row to the end of the stretch."""
    error: str = ""
    """Why not."""
    environment: Mapping[str, str] | None = None
    """Where, if that is not this process."""
    ends: bool = True
    """Whether nothing more comes of the stretch."""


def joined(parts: Sequence[Columns]) -> Columns:
    """The columns of rounds, one after another."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


class Crew(ABC):
    """Whoever computes what is missing."""

    @abstractmethod
    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        """Take stretches until nothing is left, or somebody wants to stop, and give what was made of each.

        Args:
            plan: What is swept.
            share: Where stretches come from.
            leases: To be told when this process has shown that it can compute.
            pace: How long stretches are.
            stop: Whether to finish what is in work and leave the rest.
        """

    def close(self) -> None:  # noqa: B027 - most have nothing to give back
        """Let go of whoever else was asked."""


class Alone(Crew):
    """This process, round by round.

    Args:
        told: Called with the columns of each round.
    """

    def __init__(self, told: Callable[[Columns], None]) -> None:
        self._told = told

    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        """See `Crew.work`."""
        while not stop():
            stretch = share.next(pace.stretch)
            if stretch is not None:
                yield from self._made(plan, stretch, leases, pace, stop)
            elif share.finished():
                return
            else:
                share.wait(stop)

    def _made(self, plan: Plan, stretch: Stretch, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        """Files of a stretch, one after another."""
        import jax

        devices, length = jax.local_device_count(), pace.length
        parts: list[Columns] = []
        first = done = stretch[0]
        began, before = time.perf_counter(), so_far()

        def chunk(ends: bool) -> ComputedChunk:
            return ComputedChunk(stretch, first, done, joined(parts), ends=ends)

        try:
            for end, columns in rounds(plan, stretch, stop):
                now, heard = time.perf_counter(), so_far()
                pace.tell(padded(plan, devices, done, end), now - began, heard.since(before))
                done, began, before = end, now, heard
                leases.warm = True
                self._told(columns)
                parts.append(columns)
                if done - first >= length and done < stretch[1]:
                    # There is more: one round is always ahead, even where somebody wants to stop.
                    yield chunk(ends=False)
                    first, parts = done, []
        except RowsFailedError as error:
            yield ComputedChunk(stretch, first, stretch[1], None, f"{error}")
            return
        yield chunk(ends=True)


def rounds(plan: Plan, stretch: Stretch, stop: Stop) -> Iterator[tuple[int, Columns]]:
    """Rounds of a stretch: the place behind each, and its columns. Devices work on one ahead of what is asked for.

    Raises:
        RowsFailedError: The message says of what.
    """
    width, (first, last) = round_of(plan), stretch
    begun: deque[tuple[int, Callable[[], Columns]]] = deque()
    try:
        while begun or first < last:
            if first < last and len(begun) < AHEAD:
                end = min(first + width, last)
                begun.append((end, begin(plan, first, end)))
                first = end
                continue
            end, finish = begun.popleft()
            yield end, finish()
            if stop():
                last = first
    # Of any type: whatever is wrong with these rows, the others are still wanted.
    except Exception as reason:
        raise RowsFailedError(f"{type(reason).__name__}: {reason}") from reason
