"""The room that everybody searches: the tuner's bounds, as shares from 0 to 1 along each of its axes."""

from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tuning.job.space import FreeParameter


def vectors(axes: Sequence[FreeParameter], shares: Float[np.ndarray, "n size"]) -> Float[np.ndarray, "n size"]:
    """The tuner's unconstrained vectors; the very ends are left out, as for its own starts."""
    columns = []
    for axis, share in _columns(axes, shares):
        low, high = np.log([axis.low, axis.high]) if axis.log else (axis.low, axis.high)
        along = low + (high - low) * share
        columns.append(axis.unconstrained(np.exp(along) if axis.log else along))
    return np.stack(columns, axis=1)


def shares(axes: Sequence[FreeParameter], z: Float[np.ndarray, "n size"]) -> Float[np.ndarray, "n size"]:
    """The inverse of `vectors`."""
    columns = []
    for axis, column in _columns(axes, z):
        value = np.asarray(axis.value(jnp.asarray(column)))
        ends = np.array([axis.low, axis.high])
        (low, high), along = (np.log(ends), np.log(value)) if axis.log else (ends, value)
        columns.append((along - low) / (high - low))
    return np.stack(columns, axis=1)


def _columns(axes: Sequence[FreeParameter], rows: np.ndarray) -> Iterator[tuple[FreeParameter, np.ndarray]]:
    """Each axis with its column; every entry of a diagonal has one."""
    return zip([axis for axis in axes for _ in range(axis.size)], rows.T, strict=True)
