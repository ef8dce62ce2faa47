"""Files that somebody else wrote: regular ones of bounded size, and of what a parser makes of them only plain data.

Whatever the system or a parser raises on the way becomes an `InputError` here, so that nobody behind has to think of a
pipe that never ends, a list nested ten thousand deep, a number of five thousand digits or a name with a NUL in it.
"""

import json
import os
import re
import stat
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxmpc.files.errors import InputError, UnreadableError, plain

LARGEST_TEXT = 2 * 2**20
"""Largest TOML file [bytes], which takes a second or two to parse; a spec has a few thousand."""
LARGEST_JSON = 64 * 2**20
"""Largest JSON file [bytes]: the manifest of a sweep whose axes are long lists."""
LARGEST_RECORDING = 256 * 2**20
"""Largest table of samples [bytes]: an hour of nine columns at 1 kHz."""
DEEPEST = 32
"""Deepest nesting of arrays and tables [-]; a spec of ours has six."""
_DOTTED = re.compile(rf"(?:[\w-]+[ \t]*\.[ \t]*){{{DEEPEST}}}")
_INTEGERS = range(-(2**63), 2**63)
"""What TOML promises to hold; no float and no array can take more without a loss."""


def read_bytes(path: str | Path, largest: int = LARGEST_TEXT, key: str | None = None) -> bytes:
    """The bytes of a regular file of bearable size.

    Args:
        path: Of the file; a symbolic link is followed.
        largest: Size up to which it is read [bytes].
        key: What named the file, for messages; the path itself unless given.

    Raises:
        InputError: There is no such file, it is no file but a folder, a pipe or a device, or it is too large.
        UnreadableError: It is there, and the system does not give what is in it: a right, a disk, a network.
    """
    path, named = Path(path), str(path) if key is None else key
    found = "not readable" if key is None else str(path)
    try:
        # A pipe that nobody writes to would be waited for; the flag means nothing to a file.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            status = os.fstat(file.fileno())
            if stat.S_ISDIR(status.st_mode):
                raise InputError(named, found, "a file", "It is a folder.")
            if not stat.S_ISREG(status.st_mode):
                raise InputError(named, found, "a regular file", "Pipes and devices may never end: save it first.")
            data = file.read(largest + 1)
    except InputError:
        raise
    except OSError as error:
        kind = InputError if isinstance(error, FileNotFoundError | NotADirectoryError) else UnreadableError
        raise kind(named, found, "a readable file", f"It cannot be read: {error.strerror}.") from None
    except ValueError:
        raise InputError(named, found, "a path", "No path has a NUL in it.") from None
    if len(data) > largest:
        raise InputError(named, f"more than {largest} bytes", "smaller", "It is no file that belongs here.")
    return data


def read_text(path: str | Path, largest: int = LARGEST_TEXT, key: str | None = None) -> str:
    """The text of such a file, its lines ended by line feeds alone.

    Raises:
        InputError: See `read_bytes`; or it is not UTF-8.
    """
    try:
        return read_bytes(path, largest, key).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError("text", f"byte {error.start}", "UTF-8", "Save the file as UTF-8.", Path(path)) from None


def toml_of(text: str, path: Path) -> dict[str, Any]:
    """The tables of TOML text.

    Args:
        text: Of a file.
        path: Its name, for messages.

    Raises:
        InputError: It is not TOML (a duplicate key, say), or not `plain_data`.
    """
    if found := _DOTTED.search(text):
        line = text.count("\n", 0, found.start()) + 1
        remedy = "Write tables by their own headers."
        raise InputError("key", found[0], f"of fewer than {DEEPEST} parts", remedy, path, line)
    return _parsed(text, "TOML", path, tomllib.loads)


def json_of(text: str, path: Path) -> dict[str, Any]:
    """The table of JSON text; otherwise as `toml_of`, and NaN is no JSON."""

    def loads(text: str) -> Any:
        return json.loads(text, parse_constant=_no_number)

    return _parsed(text, "JSON", path, loads)


def table_if_any(path: Path) -> dict[str, Any]:
    """The table of a small JSON file that can be done without; empty where it is missing, damaged or no table."""
    try:
        data = json.loads(read_bytes(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def _parsed(text: str, kind: str, path: Path, loads: Callable[[str], Any]) -> dict[str, Any]:
    try:
        # The newline lets a mistake in an unfinished last line have a line number.
        data = loads(text + "\n")
    except RecursionError:
        raise InputError(kind, "nested too deep", f"nested at most {DEEPEST} deep", "Flatten it.", path) from None
    except (ValueError, OverflowError) as error:
        said = re.search(r"line (\d+)", str(error))
        number = int(said[1]) if said else None
        lines = text.splitlines()
        here = lines[number - 1].strip() if number and number <= len(lines) else "the end of the file"
        # Python speaks of its own setting where an integer has more digits than it reads.
        why = "An integer in it has thousands of digits" if "digits" in str(error) else f"{error}"
        raise InputError(kind, here, f"valid {kind}", f"{why}.", path, number) from None
    if not isinstance(data, dict):
        raise InputError(kind, plain(text, 40), "a table", "Other files hold lists.", path)
    try:
        plain_data(data)
    except InputError as error:
        raise error.at(path) from None
    return data


def plain_data(data: dict[str, Any]) -> None:
    """Refuse what no spec of ours means, and what the code behind could stumble over.

    Raises:
        InputError: It is nested too deep, an integer has more than 64 bits, or text holds a control character.
    """
    waiting: list[tuple[str, Any, int]] = [("", data, 0)]
    while waiting:
        key, value, depth = waiting.pop()
        if depth > DEEPEST:
            raise InputError(key, "nested too deep", f"nested at most {DEEPEST} deep", "Flatten it.")
        if isinstance(value, dict):
            for name, each in value.items():
                _check_text(key or "the file", name)
                waiting.append((f"{key}.{name}".lstrip("."), each, depth + 1))
        elif isinstance(value, list):
            waiting += [(key, each, depth + 1) for each in value]
        elif isinstance(value, str):
            _check_text(key, value)
        elif isinstance(value, int) and value not in _INTEGERS:
            raise InputError(key, f"an integer of {value.bit_length()} bits", "of 64 bits", "Write 1e30, say.")


def _check_text(key: str, text: str) -> None:
    if any(ord(c) < 32 or 127 <= ord(c) < 160 for c in text):
        raise InputError(key, text, "text without control characters", "Remove them.")


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is no number of JSON")
