"""Ctrl-C is always heard."""

import _thread
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SOON = 0.05
"""Seconds after which it strikes again."""


@contextmanager
def always_heard() -> Iterator[None]:
    """Ctrl-C that strikes where Python can raise nothing, in a finaliser or a callback, strikes again right after."""
    before = sys.unraisablehook

    def again(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # Not at once: it would strike in here.
            threading.Timer(SOON, _thread.interrupt_main).start()
        else:
            before(unraisable)

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = before
