"""The least and the greatest of a few numbers, taken where they stand, so that their slopes are numbers too.

The derivative of `jnp.min` is that of all values equal to what it found, divided by their number. Where a compiler
computes a value once for the search and once more for the comparison, to other last bits, none is equal, and the
derivative is not a number: seen with jax 0.10 and 0.11.
"""

import jax.numpy as jnp
from jaxtyping import Array, Real


def least(values: Real[Array, "... n"]) -> Real[Array, "..."]:
    """The least over the last dimension, with the derivatives of one that is; what is not a number stays so."""
    return _taken(values, jnp.argmin(values, axis=-1, keepdims=True))


def greatest(values: Real[Array, "... n"]) -> Real[Array, "..."]:
    """The greatest over the last dimension, likewise."""
    return _taken(values, jnp.argmax(values, axis=-1, keepdims=True))


def _taken(values: Array, place: Array) -> Array:
    found: Array = jnp.take_along_axis(values, place, axis=-1)
    return found[..., 0]
