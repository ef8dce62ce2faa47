"""Wrong input, said in one sentence that names the key, the value, the bound and the remedy."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any


@dataclass(eq=False)
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
        value = self.value if isinstance(self.value, str) else f"{self.value}"
        return f"{where}{self.key} = {value}: must be {self.bound}. {self.remedy}"

    def at(self, file: Path, line: int | None = None) -> "InputError":
        """The same error, placed in a file."""
        return replace(self, file=file, line=line)


def nearest(name: str, known: list[str]) -> str:
    """A remedy for an unknown name: the likeliest meant one, and all that exist."""
    import difflib

    close = difflib.get_close_matches(name, known, n=1)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    return f"{hint}Known: {', '.join(known)}."
