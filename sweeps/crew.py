"""Who computes: this process, or others that it asks. The result is the same."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from sweeps.blocks import padded
from sweeps.compute import compute, round_of
from sweeps.leases import Leases, Stretch
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan
from sweeps.share import Share

Stop = Callable[[], bool]


class ComputedChunk(NamedTuple):
    """What was made of a stretch."""

    stretch: Stretch
    """As it was taken."""
    last: int
    """Place behind the last row that was computed: before its end where somebody wanted to stop."""
    columns: Columns | None
    """None where nothing could be computed."""
    error: str = ""
    """Why not."""
    environment: Mapping[str, str] | None = None
    """Where, if that is not this process."""


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
        import jax
        import numpy as np

        width, devices = round_of(plan), jax.local_device_count()
        while not stop():
            stretch = share.next(pace.length)
            if stretch is None:
                if share.finished():
                    return
                share.wait(stop)
                continue
            parts: list[Columns] = []
            begin, (_, last) = stretch[0], stretch
            error = ""
            while begin < last and not (parts and stop()):
                end, began = min(begin + width, last), time.perf_counter()
                try:
                    parts.append(compute(plan, begin, end))
                # Of any type: whatever is wrong with these rows, the others are still wanted.
                except Exception as reason:
                    error = f"{type(reason).__name__}: {reason}"
                    break
                pace.tell(padded(plan, devices, begin, end), time.perf_counter() - began)
                leases.warm = True
                self._told(parts[-1])
                begin = end
            if error:
                yield ComputedChunk(stretch, stretch[0], None, error)
                continue
            yield ComputedChunk(
                stretch, begin, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            )
