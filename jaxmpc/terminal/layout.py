"""Tables as plain text: as wide as the terminal at most, and no number of them is ever cut.

What does not fit side by side is stacked: the columns go into several tables, each with the leading ones again.
"""

import os
import sys
import textwrap
import unicodedata
from collections.abc import Sequence
from typing import TextIO

GAP = 3
"""Spaces between columns."""
UNLIMITED = 10**6
"""Width of what is no terminal: who reads a pipe finds each row on one line."""


def columns_of_output() -> int:
    """Characters in a line of standard output."""
    return columns_of(sys.stdout)


def columns_of(stream: TextIO) -> int:
    """Characters in a line of a stream."""
    try:
        return os.get_terminal_size(stream.fileno()).columns if stream.isatty() else UNLIMITED
    except (OSError, ValueError):
        return UNLIMITED


def table(header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None, keys: int = 1) -> str:
    """Rows of cells below their headings.

    Args:
        header: Headings.
        rows: Cells, as many in each row.
        width: Characters of a line; None is that of the output [-].
        keys: Leading columns that say what a row is about; text, to the left.

    Returns:
        Lines, without a line feed at the end.
    """
    width = columns_of_output() if width is None else width
    grid = [list(header), *map(list, rows)]
    widths = [max(map(cells, column)) for column in zip(*grid, strict=True)]
    if _total(widths) > width:
        # What a row is about may wrap, figures not.
        widths[0] = min(widths[0], max(width // 3, 12))
    lead = _total(widths[:keys])
    parts: list[list[int]] = []
    for column in range(keys, len(widths)):
        if not parts or lead + sum(GAP + widths[c] for c in parts[-1]) + GAP + widths[column] > width:
            parts.append([])
        parts[-1].append(column)
    drawn = [_drawn(grid, [*range(keys), *part], widths, keys) for part in parts or [[]]]
    return "\n\n".join(drawn)


def cells(text: str) -> int:
    """Places that text takes on a terminal: none for an accent, two for a wide character."""
    return sum(0 if unicodedata.combining(c) else 1 + (unicodedata.east_asian_width(c) in "WF") for c in text)


def _total(widths: Sequence[int]) -> int:
    return 2 + sum(widths) + GAP * (len(widths) - 1)


def _drawn(grid: list[list[str]], columns: list[int], widths: list[int], keys: int) -> str:
    lines = []
    for number, row in enumerate(grid):
        # A name that fits stays as it is, indented too; an accent is a character to textwrap, but takes no place.
        fits = cells(row[0]) <= widths[0]
        first, *rest = [row[0]] if fits else textwrap.wrap(row[0], widths[0], drop_whitespace=True)
        line = [_padded(first, widths[0], left=True)]
        line += [_padded(row[column], widths[column], left=column < keys) for column in columns[1:]]
        lines.append(f" {(' ' * GAP).join(line)}".rstrip())
        lines += [f" {each}" for each in rest]
        if number == 0:
            lines.append(" " + "─" * (_total([widths[column] for column in columns]) - 2))
    return "\n".join(lines)


def _padded(text: str, width: int, *, left: bool) -> str:
    space = " " * (width - cells(text))
    return text + space if left else space + text
