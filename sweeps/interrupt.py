"""Ctrl-C: the first finishes the round in work and keeps it, the second stops at once."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def gently(enabled: bool = True) -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C and the terminate signal of a queue into a wish.

    Args:
        enabled: False leaves signals as they are; so does a thread that is not the main one.

    Yields:
        Whether somebody wants to stop.
    """
    wished = threading.Event()
    if not enabled or threading.current_thread() is not threading.main_thread():
        yield wished.is_set
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if wished.is_set():
            raise KeyboardInterrupt
        wished.set()
        sys.stderr.write("\nfinishing the round in work, which is kept; once more stops at once\n")

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wished.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
