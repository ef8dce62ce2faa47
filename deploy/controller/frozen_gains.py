"""Gains of a frozen controller, checked against what the law declares of them, and as plain data."""

from collections.abc import Mapping
from typing import Any

from deploy.controller.checks import AGAIN, array, constants, keyed
from jaxmpc.files.errors import InputError
from jaxmpc.law.cascade import Gains, constant_reference, order
from jaxmpc.law.scalar import Constant, declared


def checked(gains: Any) -> Gains:
    """The same as floats and tuples of floats, as the law takes its constants.

    Args:
        gains: One controller, or a table of one: numbers and arrays of any library that numpy can read.

    Raises:
        InputError: A value is missing, unknown, malformed or out of range.
    """
    found: Gains = _checked(Gains, gains, "gains", "")
    if not 1 <= order(found) <= 3:
        raise InputError("K", f"{len(found.K)} numbers", "4 to 6", "The disturbance order is 1, 2 or 3.")
    array("sum of mpc_ref", constant_reference(found).mpc_ref, (1,))
    return found


def plain(gains: Gains) -> dict[str, Any]:
    """As plain data, without the parts that are missing."""
    table = {name: value for name, value in gains._asdict().items() if value is not None}
    return {name: value._asdict() if hasattr(value, "_asdict") else value for name, value in table.items()}


def _checked(kind: Any, value: Any, name: str, prefix: str) -> Any:
    known, table = declared(kind), dict(value) if isinstance(value, Mapping) else value
    parts = [key for key, each in known.items() if not isinstance(each, Constant)]
    if isinstance(table, dict):
        table = dict.fromkeys(parts) | table
    table = keyed(name, table, known)
    found = {}
    for key, each in known.items():
        if isinstance(each, Constant):
            found[key] = _constant(f"{prefix}{key}", table[key], each)
        else:
            found[key] = None if table[key] is None else _checked(each, table[key], key, f"{key}.")
    return kind(**found)


def _constant(name: str, value: Any, declaration: Constant) -> Any:
    found = constants(name, value, declaration.shape)
    low, below = declaration.low, declaration.below
    if (low is not None and found < low) or (below is not None and found >= below):
        bound = f"at least {low:g}" if below is None else f"in [{low:g}, {below:g})"
        raise InputError(name, found, bound, AGAIN)
    return found
