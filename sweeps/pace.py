"""How many rows are taken at once, as many as take a few seconds; and how many a file holds."""

from sweeps.compiling import Compiling

CHUNK_SECONDS = 5.0
"""Work that is taken at once, one chunk file or several [s]: what a kill can cost."""


class Pace:
    """How many rows make a chunk, from how long rows have taken.

    Args:
        fixed: Rows of a chunk; None is `CHUNK_SECONDS` of work.
        width: Rows that are computed side by side.
        most: Most rows of a chunk.
    """

    def __init__(self, fixed: int | None, width: int, most: int) -> None:
        # Whole rounds: what a chunk has beyond them is computed and thrown away.
        self._fixed, self._width, self._most = fixed, width, most // width * width or most
        self.length = self.stretch = fixed or min(width, most)
        """Rows of a chunk file, and of what is taken at once."""
        self.first_s = self.seconds = 0.0
        self.compiling = Compiling()
        """What the first round compiled."""
        self.rounds = self.rows = 0
        """Rounds so far, and the padded rows of all but the first, which may have compiled."""

    def tell(self, padded_rows: int, seconds: float, compiling: Compiling | None = None) -> None:
        """A round of so many rows took so long, compiling included."""
        self.rounds += 1
        if self.rounds == 1:
            self.first_s, self.compiling = seconds, compiling or Compiling()
            return
        self.rows, self.seconds = self.rows + padded_rows, self.seconds + seconds
        if self._fixed is None and self.seconds > 0.0:
            wanted = max(int(CHUNK_SECONDS * self.rows / self.seconds) // self._width, 1) * self._width
            self.length = min(wanted, self._most)
            # Files that are no whole rounds stand alone.
            self.stretch = self.length if self.length % self._width else wanted // self.length * self.length
