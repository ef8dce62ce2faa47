"""On which line of a TOML file a key stands, for messages."""

import re
from collections.abc import Iterator, Sequence

_HEADER = re.compile(r"\s*\[+\s*([^\]]+?)\s*\]+")
_ENTRY = re.compile(r"\s*([\w.-]+)\s*=")


def line_of(text: str, key: str) -> int | None:
    """The line of a TOML file that sets a dotted key, or else the nearest table around it, counted from 1.

    Tables that several places hold, as `experiment` of a spec and of its stages, are told apart by their whole names;
    only a key of which no table has such a name is looked for under the last one's, or anywhere.
    """
    parts = [part for part in re.split(r"[.\[\]]", key) if part and not part.isdigit()]
    entries, headers = _lines(text)
    names = [(number, [*table, *entry]) for number, table, entry in entries]
    for shorter in range(len(parts), 1, -1):
        if (found := _first(names, parts[:shorter])) or (found := _first(headers, parts[:shorter])):
            return found
    while parts:
        under = [(number, name) for number, name in names if name[-1] == parts[-1]]
        last = [number for number, name in under if len(parts) == 1 or parts[-2] in name[:-1]]
        header = [number for number, table in headers if table[-1] == parts[-1]]
        if last or header or under:
            return (last or header or [number for number, _ in under])[0]
        parts = parts[:-1]
    return None


def _lines(text: str) -> tuple[list[tuple[int, list[str], list[str]]], list[tuple[int, list[str]]]]:
    """Line, table and name of each entry; line and name of each table."""
    table: list[str] = []
    entries, headers = [], []
    for number, line in enumerate(text.splitlines(), 1):
        if found := _HEADER.match(line):
            table = found[1].split(".")
            headers.append((number, table))
        elif found := _ENTRY.match(line):
            entries.append((number, table, found[1].split(".")))
    return entries, headers


def _first(named: Sequence[tuple[int, list[str]]], parts: list[str]) -> int | None:
    """The first line whose name ends as wanted."""
    lines: Iterator[int] = (number for number, name in named if name[-len(parts) :] == parts)
    return next(lines, None)
