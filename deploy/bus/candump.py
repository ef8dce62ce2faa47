"""A log of the bus as `candump -L` writes it, which every CAN tool reads; a thread writes, the loop only queues."""

import threading
import time
from collections import deque
from pathlib import Path
from typing import Protocol

CAPACITY = 16384
"""Frames that may wait for the disk: two seconds of a loop with force sensor."""
_BATCH, _PAUSE = 256, 0.02


class LoggedFrame(Protocol):
    """What is logged of a frame."""

    @property
    def id(self) -> int:
        """11 bit."""

    @property
    def data(self) -> bytes:
        """Up to 8."""


class BusLog:
    """Writes frames to a file; where the disk is slower than the bus, frames are dropped and counted.

    Start it after `deploy.loop.realtime.prepare`: its thread then has the loop's priority and cannot be put aside by
    other programs while the loop waits for what it holds.
    """

    def __init__(self, path: Path, channel: str = "can0", capacity: int = CAPACITY) -> None:
        """Open the file and start the thread.

        Args:
            path: Where to; python-can takes it for a candump log if it ends in .log.
            channel: Name of the bus in the log.
            capacity: Frames that may wait.

        Raises:
            OSError: The file cannot be opened.
        """
        self.path, self.dropped, self.written = path, 0, 0
        self._channel, self._capacity = channel, capacity
        self._queue: deque[tuple[int, int, bytes, bool]] = deque()
        self._file = path.open("w", encoding="ascii")
        self._failed = ""
        # Frames are stamped by the monotonic clock; the log has wall time, as it was when the log began.
        self._offset = time.time_ns() - time.monotonic_ns()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="bus log", daemon=True)
        self._thread.start()

    def add(self, frame: LoggedFrame, stamp: int, sent: bool) -> None:
        """Queue a frame with its monotonic stamp [ns]; never waits, never raises."""
        if len(self._queue) < self._capacity:
            self._queue.append((stamp, frame.id, frame.data, sent))
        else:
            self.dropped += 1

    @property
    def complete(self) -> bool:
        """Whether all frames up to now were written, or still wait."""
        return not (self._failed or self.dropped)

    def close(self) -> str:
        """Write what waits, for at most 5 s, and say what became of the log."""
        self._closing.set()
        self._thread.join(5.0)
        waiting = len(self._queue)
        failed = self._failed or ("the disk does not answer" if self._thread.is_alive() else "")
        lost = self.dropped + waiting
        if failed:
            self._failed = failed
        text = f"bus log: {self.written} frames in {self.path}, {lost} dropped"
        return f"{text}; writing failed: {failed}" if failed else text

    def _work(self) -> None:
        while not self._closing.wait(_PAUSE):
            self._drain()
        self._drain()
        try:
            self._file.close()
        except OSError as error:
            self._failed = self._failed or str(error.strerror)

    def _drain(self) -> None:
        while self._queue:
            batch = [self._queue.popleft() for _ in range(min(len(self._queue), _BATCH))]
            try:
                if self._failed:
                    raise OSError
                self._file.write("".join(map(self._line, batch)))
                self._file.flush()
                self.written += len(batch)
            except OSError as error:
                self._failed = self._failed or str(error.strerror)
                self.dropped += len(batch)

    def _line(self, entry: tuple[int, int, bytes, bool]) -> str:
        stamp, number, data, sent = entry
        seconds, rest = divmod(stamp + self._offset, 1_000_000_000)
        return (
            f"({seconds}.{rest // 1000:06d}) {self._channel} {number:03X}#{data.hex().upper()} {'T' if sent else 'R'}\n"
        )
