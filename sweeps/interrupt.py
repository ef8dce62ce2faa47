"""Ctrl-C: the first finishes the round in work and keeps it, the second stops at once."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class _Wish(threading.Event):
    """Set by the first signal that it handles."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.is_set():
            raise KeyboardInterrupt
        self.set()
        sys.stderr.write("\nfinishing the round in work, which is kept; once more stops at once\n")


@contextmanager
def gently(enabled: bool = True) -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C and the terminate signal of a queue into a wish, which inner ones share: it lasts to the outer's end.

    Args:
        enabled: False leaves signals as they are; so does a thread that is not the main one.

    Yields:
        Whether somebody wants to stop.
    """
    wish = _Wish()
    if not enabled or threading.current_thread() is not threading.main_thread():
        yield wish.is_set
        return
    if isinstance(outer := signal.getsignal(signal.SIGINT), _Wish):
        yield outer.is_set
        return
    before = {number: signal.signal(number, wish) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wish.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
