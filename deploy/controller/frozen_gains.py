"""Gains of a frozen controller: shapes and numbers are checked when read, then plain floats are handed to the law."""

from collections.abc import Mapping
from typing import Any

from deploy.controller.checks import AGAIN, array, constants, keyed
from jaxmpc.files.errors import InputError
from jaxmpc.law.cascade import Gains, constant_reference, order
from jaxmpc.law.gain_backoff import GainBackoff

SHAPES: Mapping[str, tuple[int | None, ...]] = {
    "phi": (2,), "gamma": (2,), "K": (None,), "L": (3,), "input_gain": (),
    "mpc_ref": (None,), "mpc_x": (2,), "mpc_u": (),
}  # fmt: skip
"""Shapes of the gains; None stands for any length but 0. Only a guarded controller has a guard besides."""


def checked(gains: Gains) -> Gains:
    """The same as floats and tuples of floats, as the law takes its constants.

    Args:
        gains: One controller: numbers and arrays of any library that numpy can read; its guard may be a table.

    Raises:
        InputError: A value is malformed or out of range.
    """
    numbers = {name: constants(name, getattr(gains, name), shape) for name, shape in SHAPES.items()}
    found = Gains(**numbers, guard=None if gains.guard is None else _guard(gains.guard))
    if not 1 <= order(found) <= 3:
        raise InputError("K", f"{len(found.K)} numbers", "4 to 6", "The disturbance order is 1, 2 or 3.")
    array("sum of mpc_ref", constant_reference(found).mpc_ref, (1,))
    return found


def plain(gains: Gains) -> dict[str, Any]:
    """As plain data; without a guard there is no word of it."""
    table = gains._asdict()
    guard = table.pop("guard")
    return table if guard is None else table | {"guard": guard._asdict()}


def _guard(value: Any) -> GainBackoff:
    """A guard of floats, from one or from the table of one."""
    table = keyed("guard", value, GainBackoff._fields)
    found = GainBackoff(**{name: constants(f"guard.{name}", table[name], ()) for name in GainBackoff._fields})
    for name, number in found._asdict().items():
        # Poles and shares of a sample: below 1, so that the gain stays above its least.
        good, bound = (number > 0.0, "positive [1/N²]") if name == "sensitivity" else (0.0 <= number < 1.0, "in [0, 1)")
        if not good:
            raise InputError(f"guard.{name}", number, bound, AGAIN)
    return found
