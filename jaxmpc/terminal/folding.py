"""Prose on a terminal: a line that is too long goes on below, between words, so that no number is torn in two."""

import io
import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import TextIO

from jaxmpc.terminal import layout


@contextmanager
def folded_output() -> Iterator[None]:
    """Standard output and errors that fold their lines, each where it is a terminal; elsewhere nothing changes."""
    with ExitStack() as stack:
        if sys.stdout.isatty():
            stack.enter_context(redirect_stdout(Folded(sys.stdout)))
        if sys.stderr.isatty():
            stack.enter_context(redirect_stderr(Folded(sys.stderr)))
        yield


class Folded(io.TextIOBase):
    """A stream that folds what is written to it at the width that the terminal has at that moment."""

    def __init__(self, stream: TextIO) -> None:
        """Write to a terminal."""
        self._stream, self._place, self._begun = stream, 0, False

    def write(self, text: str) -> int:
        """Write text; what rewrites its line is left alone."""
        plain = "\r" not in text and "\x1b" not in text
        self._stream.write("".join(map(self._line, text.splitlines(keepends=True))) if plain else text)
        return len(text)

    def _line(self, line: str) -> str:
        width, body = layout.columns_of(self._stream), line.rstrip("\n")
        indent = len(body) - len(body.lstrip(" "))
        below = "\n" + " " * (indent + 2 if indent < width // 2 else 0)
        out = ""
        for gap, word in re.findall(r"(\s*)(\S+|$)", body):
            if self._begun and word and self._place + len(gap) + layout.cells(word) > width:
                out, self._place, gap = out.rstrip(" ") + below, len(below) - 1, ""
            out += gap + word
            self._place += len(gap) + layout.cells(word)
            self._begun = self._begun or bool(word)
        if line.endswith("\n"):
            out, self._place, self._begun = out + "\n", 0, False
        return out

    def flush(self) -> None:
        """Flush the terminal."""
        self._stream.flush()

    def fileno(self) -> int:
        """Descriptor of the terminal."""
        return self._stream.fileno()

    def isatty(self) -> bool:
        """Whether it is one."""
        return self._stream.isatty()

    @property
    def encoding(self) -> str:  # type: ignore[override]  # a plain attribute there
        """That of the terminal."""
        return self._stream.encoding
