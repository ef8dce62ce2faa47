"""Threads for what goes on beside the rest, such as compiling."""

from concurrent.futures import ThreadPoolExecutor
from types import TracebackType


class Beside(ThreadPoolExecutor):
    """Threads; who is interrupted or fails does not wait for them."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for them, unless Ctrl-C has struck, or something has failed whose user would wait minutes for a word."""
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)
