"""Counts of a sensor, an encoder or a torque command."""

from typing import Any

Scalar = Any


def quantise(value: Scalar, lsb: Scalar, ops: Any, offset: float = 0.5) -> Scalar:
    """Value rounded to a multiple of its least significant bit; a bit of 0 rounds nothing.

    Args:
        value: Any.
        lsb: Least significant bit, not negative, in the unit of the value.
        ops: Where `where` and `floor` are.
        offset: 0.5 rounds half up, 0 rounds down [-].
    """
    step = ops.where(lsb > 0.0, lsb, 1.0)
    return ops.where(lsb > 0.0, ops.floor(value / step + offset) * step, value)
