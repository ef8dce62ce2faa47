"""Statistics of the running loop: lateness, computing time, clamped cycles.

Counters have a fixed size from the start, so counting neither collects nor grows.
"""

from itertools import pairwise
from math import inf, sqrt

from deploy.loop.realtime import next_deadline

LATE_OVERRUNS, LATE_WITHIN_NS = 3, 1_000_000_000
"""So many overruns within so long [ns] are a fault, `late`. A single one is counted and nothing else."""
_ROWS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
"""Upper edges of the printed histogram [µs]."""
_BINS = _ROWS[-1]
_MOST_NAMES = 32


class Histogram:
    """Times in bins of 1 µs up to 5 ms, one more beyond; exact least, largest, mean and spread."""

    def __init__(self) -> None:
        self.bins = [0] * (_BINS + 1)
        self.count = 0
        self.least, self.most = inf, -inf
        self._mean = self._squares = 0.0

    def add(self, ns: int) -> None:
        """Count a time [ns]."""
        us = 1e-3 * ns
        self.bins[min(max(int(us), 0), _BINS)] += 1
        self.count += 1
        change = us - self._mean
        self._mean += change / self.count  # Welford: no sum that outgrows its digits
        self._squares += change * (us - self._mean)
        if us < self.least:
            self.least = us
        if us > self.most:
            self.most = us

    @property
    def mean(self) -> float:
        """Mean of all times so far [µs]."""
        return self._mean

    @property
    def stdev(self) -> float:
        """Standard deviation of the population [µs]."""
        return sqrt(self._squares / self.count) if self.count else 0.0

    def quantile(self, share: float) -> float:
        """Upper edge of the bin in which a share of the times has come together [µs]."""
        wanted, seen = share * self.count, 0
        for edge, number in enumerate(self.bins[:-1], start=1):
            seen += number
            if number and seen >= wanted:
                return min(float(edge), self.most)
        return self.most

    def summary(self) -> str:
        """Least, mean, largest, standard deviation, median and 99 % of the times [µs]."""
        if not self.count:
            return f"{'-':>10}" * 6
        values = (self.least, self.mean, self.most, self.stdev, self.quantile(0.5), self.quantile(0.99))
        return "".join(f"{value:10.1f}" for value in values)

    def rows(self) -> list[str]:
        """The histogram, from the first to the last row that is not empty."""
        edges = (0, *_ROWS)
        counts = [sum(self.bins[low:high]) for low, high in pairwise(edges)] + [self.bins[-1]]
        names = [f"{low} to {high}" for low, high in pairwise(edges)] + [f"over {_BINS}"]
        filled = [i for i, count in enumerate(counts) if count]
        first, last = (filled[0], filled[-1]) if filled else (0, -1)
        share = 40.0 / max(self.count, 1)
        shown = zip(names[first : last + 1], counts[first : last + 1], strict=True)
        return [f"  {name:>12} {count:>10}  {'#' * round(share * count)}".rstrip() for name, count in shown]


class Statistics:
    """Counts cycles, lateness, computing times and events of the loop."""

    def __init__(self, period: int) -> None:
        """Begin counting.

        Args:
            period: Of the loop [ns].
        """
        self.period = period
        self.periods, self.lateness, self.compute = Histogram(), Histogram(), Histogram()
        self.overruns = self.missed = 0
        self.counts: dict[str, dict[str, int]] = {}
        self._last: int | None = None
        self._recent = [-LATE_WITHIN_NS] * LATE_OVERRUNS

    def cycle(self, deadline: int, woke: int, done: int) -> tuple[int, bool]:
        """Count a cycle that has ended.

        Args:
            deadline: When it should have begun [ns].
            woke: When it began [ns].
            done: When it was done, waiting for replies included [ns].

        Returns:
            The next deadline [ns], never one that has passed; and whether overruns are so many that the run
            must stop, `late`.
        """
        if self._last is not None:
            self.periods.add(woke - self._last)
        self._last = woke
        self.lateness.add(woke - deadline)
        self.compute.add(done - woke)
        following, missed = next_deadline(deadline, done, self.period)
        if not missed:
            return following, False
        self.overruns += 1
        self.missed += missed
        self._recent = [*self._recent[1:], done]
        return following, done - self._recent[0] < LATE_WITHIN_NS

    def tally(self, kind: str, name: str) -> None:
        """Count an event, as `tally("clamps", "torque rate")`; names beyond 32 of a kind are "others"."""
        names = self.counts.setdefault(kind, {})
        if name not in names and len(names) >= _MOST_NAMES:
            name = "others"
        names[name] = names.get(name, 0) + 1

    def report(self, lockstep: bool = False) -> str:
        """All of it, as text.

        Args:
            lockstep: Whether time was the twin's, which no computer is late for: only events are told then.
        """
        if lockstep:
            return "\n".join(
                [f"{self.compute.count} cycles of {self.period / 1e3:g} µs, in lock-step", *self._events()]
            )
        cycles, mean = self.compute.count, self.periods.mean
        achieved = f", {1e6 / mean:.2f} Hz achieved" if mean > 0.0 else ""
        lines = [f"{cycles} cycles of {self.period / 1e3:g} µs wanted{achieved}"]
        lines += [
            f"{'[µs]':<12}" + "".join(f"{name:>10}" for name in ("min", "mean", "max", "stdev", "median", "99 %"))
        ]
        for name in ("periods", "lateness", "compute"):
            lines += [f"{name:<12}{getattr(self, name).summary()}"]
        lines += [f"overruns {self.overruns} (cycles that ended after the next deadline), cycles missed {self.missed}"]
        return "\n".join([*lines, *self._events(), "lateness [µs]", *self.lateness.rows()])

    def _events(self) -> list[str]:
        ordered = {
            kind: sorted(names.items(), key=lambda each: (-each[1], each[0])) for kind, names in self.counts.items()
        }
        return [f"{kind} " + ", ".join(f"{name} {n}" for name, n in found) for kind, found in sorted(ordered.items())]
