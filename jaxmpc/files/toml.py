"""TOML files in and out: every mistake is placed at its file, line and key."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.foreign import read_text, toml_of
from jaxmpc.files.key_line import line_of

T = TypeVar("T", bound=msgspec.Struct)

_KINDS = (
    (("tune", "goals"), "a tuning job, which `jaxmpc tune` takes"),
    (("sweep",), "the spec of a sweep, which `jaxmpc sweep` takes"),
    (("provenance",), "a tuned controller, which goes with `--params`"),
    (("params",), "parameters, which go with `--params`"),
    (("physics", "duration", "stiffness"), "an experiment, which `jaxmpc simulate` takes"),
)
"""Tables or keys that files of one kind have, and what these are; a job has parameters, too."""


def read_toml(path: str | Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: The file is missing, unreadable, not UTF-8, not TOML, or holds what no spec means.
    """
    path = Path(path)
    return toml_of(read_text(path), path)


@contextmanager
def located(path: str | Path) -> Iterator[None]:
    """Add file and line to an input error raised inside, from the key that it names."""
    try:
        yield
    except InputError as error:
        raise error.at(Path(path), _line(Path(path), error.key)) if error.file is None else error from None


def _line(path: Path, key: str) -> int | None:
    try:
        return line_of(read_text(path), key)
    except InputError:
        return None


def convert(data: Any, kind: type[T], root: str = "") -> T:
    """Plain data as a msgspec structure, with its mistakes as input errors.

    Args:
        data: What a TOML file held, or the same made in Python, in which numbers and lists may be numpy's or JAX's.
        kind: The structure wanted; it forbids unknown fields and bounds its numbers.
        root: Name of the table that `data` is, for messages.

    Raises:
        InputError: An unknown key, a missing one, a wrong type, or a value out of bounds.
    """
    try:
        return msgspec.convert(without_arrays(data), kind, strict=True)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, InputError):
            raise error.__cause__ from None
        raise _explain(error, data, kind, root) from None
    except (OverflowError, RecursionError):
        raise InputError(root or "the file", "a huge number", "of 64 bits", "Write 1e30, say.") from None


def without_arrays(data: Any) -> Any:
    """Data with numbers and lists in the place of those of numpy and JAX; all else as it is."""
    if isinstance(data, Mapping):
        return {key: without_arrays(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [without_arrays(value) for value in data]
    try:
        return data.tolist() if hasattr(data, "tolist") else data
    except TypeError:  # what JAX traces has no value yet
        return data


def plain_data(built: msgspec.Struct) -> Any:
    """A structure as plain data, one that was built in Python of numpy's numbers too."""
    return msgspec.to_builtins(built, enc_hook=_plain)


def check_built(built: msgspec.Struct, root: str = "") -> None:
    """Hold a structure that was built in Python to the types and bounds that a file's values meet when it is read.

    Raises:
        InputError: A value of the wrong type or out of bounds, with its key as in the TOML file.
    """
    convert(plain_data(built), type(built), root)


@contextmanager
def told_by_type(built: msgspec.Struct, root: str = "") -> Iterator[None]:
    """Tell by its key a value of another type, on which checks of a structure that was built in Python stumble.

    Of a file types have been checked before.
    """
    try:
        yield
    except (TypeError, AttributeError):
        check_built(built, root)
        raise


def _plain(value: Any) -> Any:
    """Numbers of numpy and JAX as Python's; what is of another kind is told by its name."""
    return value.tolist() if hasattr(value, "tolist") else f"{value}"


def _explain(error: msgspec.ValidationError, data: Any, kind: type[msgspec.Struct], root: str) -> InputError:
    text, _, path = str(error).partition(" - at `$")
    path = _named(path.strip("`").lstrip("."), data, kind)
    if unknown := re.search(r"contains unknown field `(.*)`", text):
        key = ".".join(part for part in (root, path, unknown[1]) if part)
        value = _lookup(data, f"{path}.{unknown[1]}".lstrip("."))
        return InputError(key, value, "a known key", f"Remove it, or correct its name: {text}.")
    if missing := re.search(r"missing required field `(.*)`", text):
        key = ".".join(part for part in (root, path, missing[1]) if part)
        return InputError(key, "missing", "given", f"Add `{missing[1]} = …`.")
    key, value = ".".join(part for part in (root, path) if part) or "the file", _lookup(data, path)
    if text.startswith("Invalid") and (known := _choices(kind, path)):
        return InputError(key, value, "a known word", nearest(f"{value}", known))
    if "out of range" in text:
        return InputError(key, value, "a number of at most 64 bits", "Write 1e30, say.")
    bound = re.sub(r"`(\w+)`", lambda word: _WORDS.get(word[1], word[1]), text.removeprefix("Expected "))
    return InputError(key, value, bound.replace("`", ""), "Correct the value.")


def _named(path: str, data: Any, kind: type[msgspec.Struct]) -> str:
    """A path in which names that the user chose stand, for which msgspec writes [...]."""
    table, mark, rest = path.partition("[...]")
    if not mark or not table.isidentifier():
        return path
    for name, value in _lookup(data, table).items():
        try:
            msgspec.convert({table: {name: value}}, msgspec.defstruct("_One", [(table, _type_of(kind, table))]))
        except msgspec.ValidationError:
            return f"{table}.{name}{rest}"
    return path


def _type_of(kind: type[msgspec.Struct], name: str) -> Any:
    return next(field.type for field in msgspec.structs.fields(kind) if field.encode_name == name)


_WORDS = {"object": "a table", "array": "a list", "str": "text", "int": "a whole number", "float": "a number"}
_WORDS |= {"bool": "true or false", "null": "nothing"}
"""msgspec names types as JSON does."""


def _choices(kind: type[msgspec.Struct], path: str) -> list[str]:
    """Words that a structure accepts at a path; none where it does not choose among words."""
    found: list[Any] = [msgspec.inspect.type_info(kind)]
    for part in re.findall(r"\w+|\[[^]]*\]", path):
        found = [inner for each in found for inner in _inner(each, part)]
    return [f"{word}" for each in found for word in getattr(each, "values", ())]


def _inner(kind: Any, part: str) -> list[Any]:
    """Types of an entry of a type: a field of a structure, an item of a list; the members of a union."""
    inspect = msgspec.inspect
    match kind:
        case inspect.UnionType():
            return [inner for member in kind.types for inner in _inner(member, part)]
        case inspect.StructType():
            tag = [inspect.LiteralType((kind.tag,))] if kind.tag_field == part else []
            return [
                *tag,
                *(each for field in kind.fields if field.encode_name == part for each in _members(field.type)),
            ]
        case inspect.TupleType():
            return [member for item in kind.item_types for member in _members(item)]
        case inspect.ListType() | inspect.VarTupleType():
            return _members(kind.item_type)
    return []


def _members(kind: Any) -> list[Any]:
    return list(kind.types) if isinstance(kind, msgspec.inspect.UnionType) else [kind]


def known_keys(kind: type[msgspec.Struct], table: dict[str, Any], root: str = "") -> None:
    """Refuse a key that the structure does not have, naming the likeliest meant one."""
    names = [field.encode_name for field in msgspec.structs.fields(kind)]
    for key, value in table.items():
        if key not in names:
            remedy = nearest(key, names) if root else meant(table, names) or nearest(key, names)
            raise InputError(f"{root}.{key}".lstrip("."), value, "a known key", remedy)


def known_tables(data: Mapping[str, Any], names: Sequence[str]) -> None:
    """Refuse a table that a file does not have, and what is none."""
    for name, table in data.items():
        if name not in names:
            raise InputError(name, table, "a known table", meant(data, names) or nearest(name, list(names)))
        if not isinstance(table, dict):
            raise InputError(name, table, "a table", f"Put its keys under [{name}].")


def meant(data: Mapping[str, Any], names: Sequence[str]) -> str:
    """A remedy for a file of another kind than the one that is read; empty if it does not look like one.

    Args:
        data: Its content.
        names: What a file of the wanted kind may have.
    """
    for marks, kind in _KINDS:
        if any(mark in data for mark in marks):
            return "" if any(mark in names for mark in marks) else f"The file looks like {kind}."
    return ""


def _lookup(data: Any, path: str) -> Any:
    for part in re.findall(r"\w+|\[\d+\]", path):
        index = int(part[1:-1]) if part.startswith("[") else part
        try:
            data = data[index]
        except (KeyError, IndexError, TypeError):
            return "missing"
    return data


def write_toml(path: str | Path, data: dict[str, Any], comment: str = "") -> None:
    """Write a TOML file whole or not at all, see `toml_text`."""
    from jaxmpc.files.sealed import write_atomic

    write_atomic(Path(path), toml_text(data, comment).encode())


def toml_text(data: dict[str, Any], comment: str = "") -> str:
    """Data as TOML below a comment; None, of which TOML has no word, is left out."""
    import tomli_w

    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + tomli_w.dumps(_without_none(data))


def _without_none(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _without_none(value) for key, value in data.items() if value is not None}
    return data
