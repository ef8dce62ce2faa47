"""What a user sees of a verb's output on a terminal of so many columns, by the emulator pyte."""

import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path
from typing import NamedTuple

import pyte
import pytest

from jaxmpc.cli import main
from jaxmpc.terminal import layout
from tests.sources import ROOT

WIDTHS = (60, 80, 120)


class Terminal(io.StringIO):
    """Standard output that says it is a terminal."""

    def isatty(self) -> bool:
        return True


class Edge(pyte.Screen):
    """A screen that notes what reaches beyond its right edge, where a terminal goes on below, in mid-word."""

    def __init__(self, columns: int, lines: int) -> None:
        """An empty one."""
        super().__init__(columns, lines)
        self.torn: list[str] = []

    def draw(self, data: str) -> None:
        """Draw characters."""
        for character in data:
            if self.cursor.x == self.columns and layout.cells(character):
                self.torn.append(f"{self.display[self.cursor.y]}|{character}")
            super().draw(character)


class Ran(NamedTuple):
    """A command on a terminal."""

    code: int
    data: bytes
    """All that it wrote."""
    said: str
    """What the screen shows after it."""
    torn: list[str]
    """Lines that reached beyond the edge, at any time."""


def on_terminal(columns: int, *command: str, cwd: Path, stop: float | None = None, **variables: str) -> Ran:
    """Run Python with a command line on a terminal for output and errors.

    Args:
        columns: Width of the terminal.
        command: Arguments of the interpreter.
        cwd: Where it runs.
        stop: When it gets Ctrl-C [s]; None never.
        variables: More of the environment.
    """
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 60, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        [sys.executable, *command], stdin=theirs, stdout=theirs, stderr=theirs, cwd=cwd,
        env={**environment, "TERM": "xterm", "PYTHONPATH": str(ROOT), **variables},
    )  # fmt: skip
    os.close(theirs)
    timer = threading.Timer(stop or 0.0, process.send_signal, [signal.SIGINT])
    if stop is not None:
        timer.start()
    data = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # Linux's way to say that the other end is closed
            break
        data += part
    os.close(ours)
    code = process.wait()
    timer.cancel()
    screen = Edge(columns, 1 + data.count(b"\n") * 4)
    pyte.ByteStream(screen).feed(data)
    return Ran(code, data, "\n".join(line.rstrip() for line in screen.display).rstrip(), screen.torn)


def shown(data: bytes, columns: int) -> list[str]:
    """Lines of a terminal of that width after all that was written to it."""
    screen = pyte.Screen(columns, 1 + data.count(b"\n") * 4)
    pyte.ByteStream(screen).feed(data)
    return [line.rstrip() for line in screen.display]


def numbers(text: str) -> list[str]:
    return re.findall(r"−?\d+(?:[.,]\d+)*", text)


def written(command: list[str], columns: int, monkeypatch: pytest.MonkeyPatch, code: int = 0) -> str:
    """What a verb writes to a terminal of that width."""
    terminal = Terminal()
    with monkeypatch.context() as patch:
        patch.setattr("sys.stdout", terminal)
        patch.setattr(layout, "columns_of", lambda _: columns)
        patch.setattr("jaxmpc.cli.listing.shutil.get_terminal_size", lambda: os.terminal_size((columns, 60)))
        assert main(command) == code, terminal.getvalue()
    return terminal.getvalue()


def assert_whole(text: str, columns: int) -> None:
    """Every number stands whole on the screen, and no line but that of a single long word reaches beyond it.

    Raises:
        AssertionError: One is torn, cut or missing.
    """
    for line in text.splitlines():
        assert layout.cells(line) <= columns or " " not in line.strip(), line
    lines = [line for line in text.splitlines() if layout.cells(line) <= columns]
    seen = shown("\r\n".join(lines).encode(), columns)
    assert numbers("\n".join(seen)) == numbers("\n".join(lines))
    assert "…" not in re.sub(r"\w…\w|\d … \d|^.*(?: …|…\))$", "", text, flags=re.MULTILINE), text
