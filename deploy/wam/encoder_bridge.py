"""Motor counts without holes: over lost replies, and over cycles that were missed."""

from collections.abc import Iterator, Sequence


class EncoderBridge:
    """Motor counts, extrapolated at their last rate while a reply is missing.

    Attributes:
        counts: The latest, four floats.
    """

    def __init__(self, counts: Sequence[int]) -> None:
        """Begin at rest."""
        self.counts: tuple[float, ...] = tuple(map(float, counts))
        self._told, self._since, self._rate = list(self.counts), [0] * 4, [0.0] * 4

    def take(self, counts: Sequence[int | None], missed: int = 0) -> Iterator[tuple[float, ...]]:
        """The counts of this cycle, after those of the cycles that were missed before it.

        Args:
            counts: Of the four motors; None where none came.
            missed: Cycles left out since the last call.
        """
        before, cycles = self.counts, missed + 1
        now = []
        for i, each in enumerate(counts):
            self._since[i] += cycles
            if each is not None:
                # From what was told last: what stood in for it since is only as good as the rate before.
                self._rate[i] = (each - self._told[i]) / self._since[i]
                self._told[i], self._since[i] = float(each), 0
            now.append(before[i] + cycles * self._rate[i] if each is None else float(each))
        self.counts = tuple(now)
        for k in range(1, cycles):
            share = k / cycles
            yield tuple(a + share * (b - a) for a, b in zip(before, now, strict=True))
        yield self.counts
