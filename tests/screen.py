"""What a user sees of a verb's output on a terminal of so many columns, by the emulator pyte."""

import io
import os
import re

import pyte
import pytest

from jaxmpc.cli import main
from jaxmpc.terminal import layout

WIDTHS = (60, 80, 120)


class Terminal(io.StringIO):
    """Standard output that says it is a terminal."""

    def isatty(self) -> bool:
        return True


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
        patch.setattr(layout, "columns_of_output", lambda: columns)
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
