"""Who computes: this process, or others that it asks. The result is the same."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
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


class Round(NamedTuple):
    """What was made of rows that are computed side by side."""

    end: int
    """Place behind the last of them."""
    columns: Columns | None
    """None where they could not be computed."""
    error: str = ""
    """Why not."""


class ComputedChunk(NamedTuple):
    """What was made of a stretch, or of a part of it that fills a file."""

    stretch: Stretch
    """As it was taken."""
    first: int
    """Place of the first row."""
    last: int
    """Place behind the last row that was computed: before the end of the stretch where somebody wanted to stop."""
    columns: Columns | None
    """None where they could not be computed."""
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

        devices = jax.local_device_count()

        def timed() -> Iterator[Round]:
            done, began, before = stretch[0], time.perf_counter(), so_far()
            for made in rounds(plan, stretch, stop):
                now, heard = time.perf_counter(), so_far()
                if made.columns is not None:
                    pace.tell(padded(plan, devices, done, made.end), now - began, heard.since(before))
                    leases.warm = True
                    self._told(made.columns)
                done, began, before = made.end, now, heard
                yield made

        return gathered(stretch, timed(), pace.length)


def gathered(stretch: Stretch, made: Iterable[Round], length: int) -> Iterator[ComputedChunk]:
    """Rounds of a stretch as files, one after another; each that failed stands alone.

    Args:
        stretch: As it was taken.
        made: Its rounds, one at least; wherever they end, one is always ahead.
        length: Rows from which on a file is full.
    """
    parts: list[Columns] = []
    failed: ComputedChunk | None = None
    first = done = stretch[0]

    def chunk(ends: bool) -> ComputedChunk:
        return ComputedChunk(stretch, first, done, joined(parts), ends=ends)

    for end, columns, error in made:
        if failed is not None:
            yield failed._replace(ends=False)
            failed = None
        if columns is None:
            if parts:
                yield chunk(ends=False)
            failed, parts = ComputedChunk(stretch, done, end, None, error), []
            first = done = end
            continue
        parts.append(columns)
        done = end
        if done - first >= length and done < stretch[1]:
            # There is more: one round is always ahead, even where somebody wants to stop.
            yield chunk(ends=False)
            first, parts = done, []
    yield chunk(ends=True) if failed is None else failed


def rounds(plan: Plan, stretch: Stretch, stop: Stop) -> Iterator[Round]:
    """Rounds of a stretch; one that fails costs no other. Devices work on one ahead of what is asked for."""
    width, (first, last) = round_of(plan), stretch
    begun: deque[tuple[int, Callable[[], Columns]]] = deque()
    while begun or first < last:
        if first < last and len(begun) < AHEAD:
            end = min(first + width, last)
            begun.append((end, _begun(plan, first, end)))
            first = end
            continue
        end, finish = begun.popleft()
        try:
            found = Round(end, finish())
        # Of any type: whatever is wrong with these rows, the others are still wanted.
        except Exception as reason:
            found = Round(end, None, f"{type(reason).__name__}: {reason}")
        yield found
        if stop():
            last = first


def _begun(plan: Plan, first: int, last: int) -> Callable[[], Columns]:
    """As `begin`; what that raises is raised once the columns are asked for, in the order of the rounds."""
    try:
        return begin(plan, first, last)
    except Exception as reason:
        return partial(_raised, reason)


def _raised(reason: Exception) -> Columns:
    raise reason
