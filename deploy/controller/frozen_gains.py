"""Gains of a frozen controller, checked against what the law declares of them, and as plain data."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from deploy.controller.checks import AGAIN, array, constants, keyed
from jaxmpc.files.errors import InputError
from jaxmpc.law.gains import KNOTS_APART, Gains, GainSchedule, constant_reference, order
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
    if found.schedule is not None:
        _check_family(found, found.schedule)
    return found


def _check_family(gains: Gains, family: GainSchedule) -> None:
    places = [knot.log_stiffness for knot in family.knots]
    # The least ratio of the design, but for rounding.
    if any(high - low < 0.999 * math.log(KNOTS_APART) for low, high in pairwise(places)):
        raise InputError("schedule.knots", places, "in the order of their stiffness, 0.1 % apart", AGAIN)
    for knot in family.knots:
        late = (knot.gains.K_earlier is None) == (gains.K_earlier is None)
        alike = late and len(knot.gains.K) == len(gains.K) and len(knot.gains.mpc_ref) == len(gains.mpc_ref)
        if not alike or (knot.gains.guard, knot.gains.force_filter, knot.gains.schedule) != (None, None, None):
            raise InputError("schedule.knots", "of another structure", "of the structure of the fixed gains", AGAIN)


def plain(gains: Gains) -> dict[str, Any]:
    """As plain data, without the parts that are missing."""
    table: dict[str, Any] = _plain(gains)
    return table


def _plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):
        return {name: _plain(each) for name, each in value._asdict().items() if each is not None}
    several = isinstance(value, tuple) and any(hasattr(each, "_asdict") for each in value)
    return [_plain(each) for each in value] if several else value


def _checked(kind: Any, value: Any, name: str, prefix: str) -> Any:
    known, table = declared(kind), dict(value) if isinstance(value, Mapping) else value
    parts = [key for key, each in known.items() if not isinstance(each, Constant) or each.optional]
    if isinstance(table, dict):
        table = dict.fromkeys(parts) | table
    table = keyed(name, table, known)
    return kind(**{key: _entry(each, table[key], key, f"{prefix}{key}") for key, each in known.items()})


def _entry(kind: Any, value: Any, key: str, name: str) -> Any:
    if isinstance(kind, Constant):
        return None if value is None and kind.optional else _constant(name, value, kind)
    if isinstance(kind, tuple):
        if not isinstance(value, list | tuple) or not value:
            raise InputError(name, value, "one or more tables", AGAIN)
        return tuple(_checked(kind[0], each, key, f"{name}[{i}].") for i, each in enumerate(value))
    return None if value is None else _checked(kind, value, key, f"{name}.")


def _constant(name: str, value: Any, declaration: Constant) -> Any:
    found = constants(name, value, declaration.shape)
    low, below = declaration.low, declaration.below
    if (low is not None and found < low) or (below is not None and found >= below):
        bound = f"at least {low:g}" if below is None else f"in [{low:g}, {below:g})"
        raise InputError(name, found, bound, AGAIN)
    return found
