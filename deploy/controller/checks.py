"""What comes out of a file, checked: arrays of one shape, tables of plain data."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.sealed import canonical_json

AGAIN = "Freeze the controller again."


def array(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """A read-only float64 copy of a finite array; None in the shape stands for any length but 0.

    Raises:
        InputError: It has another shape, or something in it is no finite number.
    """
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise InputError(name, f"an array of {array.dtype}", "an array of numbers", AGAIN)
    wrong = [have for have, want in zip(array.shape, shape, strict=False) if have != (want or max(have, 1))]
    if array.ndim != len(shape) or wrong:
        bound = f"of shape ({', '.join('n' if length is None else str(length) for length in shape)})"
        raise InputError(name, f"an array of shape {array.shape}", bound, "Freeze one controller, with three axes.")
    if not np.all(np.isfinite(array)):
        raise InputError(name, "not finite somewhere", "finite everywhere", "Its design or its trace has failed.")
    array = np.ascontiguousarray(array, np.float64).reshape(array.shape)
    array.setflags(write=False)
    return array


def constants(name: str, value: Any, shape: tuple[int | None, ...]) -> Any:
    """The same as Python floats in tuples, as the law takes its constants.

    Raises:
        InputError: As `array`.
    """
    return _tuples(array(name, value, shape).tolist())


def keyed(name: str, value: Any, known: Collection[str], meaning: Mapping[str, str] | None = None) -> dict[str, Any]:
    """A table, from one or from a NamedTuple, that has exactly the known keys.

    Args:
        name: Of the table.
        value: What should be one.
        known: Keys.
        meaning: What each of them is, said where it is missing.

    Raises:
        InputError: It is no table, lacks a key or has another.
    """
    table = value._asdict() if hasattr(value, "_asdict") else value
    if not isinstance(table, Mapping):
        raise InputError(name, table, f"a table of {', '.join(known)}", AGAIN)
    for key in known:
        if key not in table:
            bound = f"given: {meaning[key]}" if meaning else "given"
            raise InputError(f"{name}.{key}", "missing", bound, AGAIN)
    if surplus := [key for key in table if key not in known]:
        raise InputError(f"{name}.{surplus[0]}", table[surplus[0]], "a known key", nearest(str(surplus[0]), [*known]))
    return dict(table)


def plain(name: str, value: Any) -> None:
    """Refuse what is not a table of plain data.

    Raises:
        InputError: It is none, or holds an infinity.
    """
    try:
        if isinstance(value, dict) and canonical_json(value):
            return
    except (TypeError, ValueError):
        pass
    remedy = "Use numbers, words, lists and tables, and no infinity."
    raise InputError(name, value, "a table of plain data", remedy)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
