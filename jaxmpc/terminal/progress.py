"""Progress of long work: a bar on a terminal, a plain line now and then elsewhere."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Tick = Callable[[int, str], None]
"""Called with the work done so far and a short note."""

PATIENCE = 2.0
"""How long work is silent [s]."""
PLAIN_EVERY = 10.0
"""Seconds between two lines where there is no terminal."""


@contextmanager
def progress(title: str, total: int, unit: str = "rows", enabled: bool = True) -> Iterator[Tick]:
    """Show how far work has come, its rate and the time left, on standard error.

    Args:
        title: What is being done.
        total: All of the work.
        unit: What is counted.
        enabled: False is silent (a library call, say).
    """
    if not enabled:
        yield lambda done, note: None
    elif sys.stderr.isatty():
        yield from _bar(title, total)
    else:
        yield from _lines(title, total, unit)


def _bar(title: str, total: int) -> Iterator[Tick]:
    from rich.console import Console, RenderableType
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class BarAndNote(Progress):
        """The bar, and the note on lines of its own, where it wraps between words instead of being cut."""

        def get_renderables(self) -> Iterator[RenderableType]:
            """The two."""
            yield self.make_tasks_table(self.tasks)
            if note := self.tasks[0].fields["note"] if self.tasks else "":
                yield Text(f"  {note}")

    console = Console(stderr=True)
    # Title, both counts and the time take what a narrow terminal has; the bar takes the rest.
    rest = console.width - max(10, len(title)) - 2 * len(f"{total}") - 13
    columns = (
        TextColumn("{task.description:10}"),
        BarColumn(bar_width=max(4, min(40, rest))),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    bar = BarAndNote(*columns, console=console)
    try:
        with bar:
            task = bar.add_task(title, total=total, note="")
            yield lambda done, note: bar.update(task, completed=done, note=note)
    finally:
        # Ctrl-C while it begins has hidden the cursor, and nobody has been told to show it again.
        bar.stop()


def _lines(title: str, total: int, unit: str) -> Iterator[Tick]:
    last = time.monotonic()
    begun: tuple[int, float] | None = None

    def tick(done: int, note: str) -> None:
        nonlocal last, begun
        now = time.monotonic()
        # What came before the first time, as compiling, does not come again.
        begun = begun or (done, now)
        if now - last < PLAIN_EVERY and done < total:
            return
        last = now
        before, began = begun
        rate = (done - before) / max(now - began, 1e-9)
        left = f", {(total - done) / rate:.0f} s left" if rate > 0.0 and done < total else ""
        sys.stderr.write(f"{title}: {done}/{total} {unit}{left}  {note}\n")
        sys.stderr.flush()

    with said_after(f"{title}: {total} {unit} …"):
        yield tick


@contextmanager
def said_after(text: str, seconds: float = PATIENCE) -> Iterator[None]:
    """Say on standard error what is going on, if it takes longer than that [s]."""
    timer = threading.Timer(seconds, lambda: print(text, file=sys.stderr, flush=True))  # noqa: T201
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
