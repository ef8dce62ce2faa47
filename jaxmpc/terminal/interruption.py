"""Ctrl-C is always heard."""

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SOON = 0.05
"""Seconds after which it strikes again."""


@contextmanager
def always_heard() -> Iterator[Callable[[], bool]]:
    """Ctrl-C that strikes where Python can raise nothing, in a finaliser or a callback, strikes again right after.

    Yields:
        Whether it has struck: an extension that is interrupted while it is loaded raises an ImportError instead, which
        does not tell why.
    """
    before, strikes = sys.unraisablehook, 0

    def again(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # Not at once: it would strike in here.
            threading.Timer(SOON, _thread.interrupt_main).start()
        else:
            before(unraisable)

    def counted(number: int, frame: Any) -> None:
        nonlocal strikes
        strikes += 1
        signal.default_int_handler(number, frame)

    # A background job of a shell does not hear it, and only the main thread may listen.
    main_thread = threading.current_thread() is threading.main_thread()
    listens = main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    sys.unraisablehook = again
    try:
        if listens:
            signal.signal(signal.SIGINT, counted)
        yield lambda: strikes > 0
    finally:
        sys.unraisablehook = before
        if listens:
            signal.signal(signal.SIGINT, signal.default_int_handler)
