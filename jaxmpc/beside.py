"""Threads for what goes on beside the rest, such as compiling."""

from concurrent.futures import ThreadPoolExecutor
from types import TracebackType


class Beside(ThreadPoolExecutor):
    """Threads; who is interrupted does not wait for them."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for them, unless Ctrl-C has struck."""
        interrupted = kind is not None and issubclass(kind, KeyboardInterrupt)
        self.shutdown(wait=not interrupted, cancel_futures=interrupted)
