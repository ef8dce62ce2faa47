"""A thread beside the one that computes: a file is written while the next one's rows are computed."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self


class Writer:
    """Does one thing at a time, in order; what it raises comes out at the next call or at the end."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "writer")
        self._last: Future[None] | None = None

    @property
    def failed(self) -> bool:
        """Whether the next call is going to raise."""
        return self._last is not None and self._last.done() and self._last.exception() is not None

    def begin(self, work: Callable[[], None]) -> None:
        """Have it done, once what was asked for before is.

        Raises:
            Exception: What was asked for before has raised it.
        """
        self.settle()
        self._last = self._thread.submit(work)

    def settle(self) -> None:
        """Wait until nothing is left to do.

        Raises:
            Exception: What was asked for has raised it.
        """
        last, self._last = self._last, None
        if last is not None:
            last.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._thread.shutdown()
        if error is None:
            self.settle()
