"""Wrong input, said in one sentence that names the key, the value, the bound and the remedy."""

import operator
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args

LONGEST_VALUE, LONGEST_TEXT = 80, 1200
"""How much of a value, and of any other part, is repeated [characters]."""


@dataclass(eq=False, repr=False)
class InputError(ValueError):
    """Wrong input. The command line prints it and exits with 2; nothing has been written by then.

    Attributes:
        key: What is wrong: a parameter, a key of a file, a column, a path.
        value: The value found there.
        bound: What it must be, to follow the words "must be".
        remedy: What to do about it, a sentence.
        file: The file it came from, where there is one.
        line: Its line in that file, counted from 1.
    """

    key: str
    value: Any
    bound: str
    remedy: str
    file: Path | None = None
    line: int | None = None

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}: " if self.line else f"{self.file}: " if self.file else ""
        key, value = plain(f"{self.key}", LONGEST_VALUE), plain(_text_of(self.value), LONGEST_VALUE)
        return plain(f"{where}{key} = {value}: must be {self.bound}. {self.remedy}")

    def __repr__(self) -> str:
        return textwrap.fill(f"InputError: {self}", 100, subsequent_indent="  ")

    def __reduce__(self) -> tuple[Any, ...]:
        """Parts of a copy for another process; an exception's own are what it was called with by place."""
        return type(self), tuple(getattr(self, field.name) for field in fields(self))

    def at(self, file: Path, line: int | None = None) -> "InputError":
        """The same error, placed in a file."""
        return replace(self, file=file, line=line)


class UnreadableError(InputError):
    """A file that is there, and of which the system does not let this process know the content."""


def plain(text: str, longest: int = LONGEST_TEXT) -> str:
    """Text for one line of a terminal, whoever wrote it.

    What moves a cursor, breaks or turns a line is shown by its escape; of long text the middle is left out.

    Args:
        text: From a file, a command line or the system.
        longest: Characters kept [-].
    """
    if len(text) > longest:
        half = (longest - 1) // 2
        text = f"{text[:half]}…{text[len(text) - half :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def plain_name(key: str, name: str) -> str:
    """A name that may become one of a file or folder.

    Raises:
        InputError: It is empty or long, begins with a dot or a dash, or holds anything but letters, digits, spaces and
            `._+-()[]=,`.
    """
    odd = next((c for c in name if not (c.isalnum() or c in " ._+-()[]=,")), None)
    if odd is None and 0 < len(name) <= 100 and name[0] not in ".- " and name == name.strip():
        return name
    bound = "a plain name of at most 100 letters, digits, spaces and ._+-()[]=, that begins with none of `.- `"
    raise InputError(key, name, bound, "It becomes the name of a file.")


def within(low: float, high: float, unit: str) -> str:
    """The bound of a number that lies between two, with its unit; "-" is none and stays unsaid."""
    return f"in [{low:g}, {high:g}] {unit}".removesuffix(" -")


def check_type(key: str, value: Any, kind: Any, remedy: str) -> None:
    """Refuse an argument of another type, such as a name in the place of what has that name.

    Args:
        key: Its name.
        value: As the caller has it.
        kind: A class, or one beside None.
        remedy: What to do about another, a sentence.

    Raises:
        InputError: It is none of the kind.
    """
    if not isinstance(value, kind):
        named = next(each for each in get_args(kind) or (kind,) if each is not type(None))
        raise InputError(key, value, f"of the type {named.__name__}", remedy)


def truth(key: str, value: Any, remedy: str) -> bool:
    """A truth value, numpy's too, as Python's bool.

    Args:
        key: What it decides, for messages.
        value: As the caller has it.
        remedy: What to do about another, a sentence.

    Raises:
        InputError: It is none: whatever is not empty would count as true.
    """
    found = value.item() if getattr(value, "shape", None) == () and hasattr(value, "item") else value
    if not isinstance(found, bool):
        raise InputError(key, value, "true or false", remedy)
    return found


def check_table(key: str, value: Any) -> None:
    """Refuse what is no mapping of names to values.

    Raises:
        InputError: It is something else.
    """
    if not isinstance(value, Mapping):
        raise InputError(key, value, "a table, or a dict of its values", "Its keys are those of the TOML file.")


def counted(key: str, value: Any, remedy: str, least: int = 1, most: int | None = None) -> int:
    """A whole number within bounds, numpy's and JAX's too, as Python's int.

    Args:
        key: What is counted, for messages.
        value: As the caller has it.
        remedy: What to do about another, a sentence.
        least: The smallest that is taken.
        most: The largest; None is any.

    Raises:
        InputError: It is no whole number, or out of bounds.
    """
    try:
        found = least - 1 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        found = least - 1
    if found < least or (most is not None and found > most):
        bound = f"a whole number of at least {least}" if most is None else f"a whole number in [{least}, {most}]"
        raise InputError(key, value, bound, remedy)
    return found


def nearest(name: Any, known: list[str]) -> str:
    """A remedy for an unknown name, or for what is none: the likeliest meant one, and all that exist."""
    import difflib

    # Dashes of options would make any two of them alike.
    bare = {each.lstrip("-"): each for each in known}
    close = difflib.get_close_matches(_text_of(name)[:LONGEST_VALUE].lstrip("-"), bare, n=1)
    hint = f"Did you mean {bare[close[0]]!r}? " if close else ""
    return f"{hint}Known: {', '.join(known)}."


def _text_of(value: Any) -> str:
    """A value as text, never an empty one; a number too long to be written, or what is nested too deep, by its kind."""
    try:
        return f"{value}" or "empty"
    except (ValueError, RecursionError):
        return f"a huge {type(value).__name__}"
