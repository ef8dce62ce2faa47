"""Which limits of a quantity mean something: some nothing can keep, and some nothing can miss."""

import math
from typing import Any

from jaxmpc.files.errors import InputError
from jaxmpc.quantities.row import Quantity


def check_limit(key: str, quantity: Quantity, limit: Any, remedy: str, zero: bool = False) -> None:
    """Refuse a limit that is no number, or that no controller or every controller would keep.

    Args:
        key: Of the limit.
        quantity: What it limits.
        limit: In the quantity's unit.
        remedy: What to do.
        zero: Whether 0 is a limit too, where it is only compared: a share of no sample.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    low, high = quantity.limits
    number = isinstance(limit, int | float) and not isinstance(limit, bool)
    zero = zero and quantity.ceiling and low == 0.0
    if number and (low < limit or (zero and limit == 0.0)) and limit <= high and limit < math.inf:
        return
    bound = f"a number {'from' if zero else 'above'} {quantity.amount(low)}{' on' if zero else ''}"
    bound += "" if math.isinf(high) else f", at most {quantity.amount(high)}"
    raise InputError(key, limit, bound, remedy)
