"""Scalar searches with a fixed number of steps: they batch, and find places to the last bit of float64.

They only find places; what stands there is evaluated, and differentiated, by the caller.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Places = Float[Array, "..."]
Function = Callable[[Places], Places]

HALVINGS = 42
"""Bisection steps: a bracket of 3 % shrinks to 1e-14."""


def root(function: Function, low: Places, high: Places, rising: Bool[Array, "..."]) -> Places:
    """Where an elementwise function changes sign in each bracket.

    Args:
        function: Elementwise, so that several roots cost one program.
        low: Lower ends.
        high: Upper ends.
        rising: Whether the function goes from negative to positive there.
    """
    return _bisect(lambda at: (function(at) < 0.0) == rising, low, high)


def peak(function: Function, low: Places, high: Places) -> Places:
    """Where a function with one maximum in a bracket has it."""
    return _bisect(lambda at: jax.jvp(function, (at,), (jnp.ones_like(at),))[1] > 0.0, low, high)


def _bisect(goes_on: Callable[[Places], Bool[Array, "..."]], low: Places, high: Places) -> Places:
    def halve(_: Any, bracket: tuple[Places, Places]) -> tuple[Places, Places]:
        low, high = bracket
        middle = 0.5 * (low + high)
        onward = goes_on(middle)
        return jnp.where(onward, middle, low), jnp.where(onward, high, middle)

    low, high = jax.lax.fori_loop(0, HALVINGS, halve, (low, high))
    middle: Places = 0.5 * (low + high)
    return middle
