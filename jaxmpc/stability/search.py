"""Scalar searches on a fixed number of steps, differentiable through what they found."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]
Function = Callable[[Scalar], Scalar]

HALVINGS = 50
"""Bisection steps: a bracket of 2 % shrinks to the last bit of float64."""


def root(function: Function, low: Scalar, high: Scalar) -> Scalar:
    """Where a function changes sign in a bracket; NaN ends are carried through.

    The derivative is the implicit one: a Newton step from the root found, with the root held fixed.
    """

    def halve(_: int, bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        low, high = bracket
        middle = 0.5 * (low + high)
        same = jnp.sign(function(middle)) == sign_low
        return jnp.where(same, middle, low), jnp.where(same, high, middle)

    sign_low = jnp.sign(function(low))
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, jax.lax.stop_gradient((low, high)))
    found = jax.lax.stop_gradient(0.5 * (low + high))
    value, slope = jax.jvp(function, (found,), (jnp.ones_like(found),))
    slope = jax.lax.stop_gradient(slope)
    return found - (value - jax.lax.stop_gradient(value)) / jnp.where(slope == 0.0, 1.0, slope)


def peak(function: Function, low: Scalar, high: Scalar) -> Scalar:
    """Largest value of a function with one maximum in a bracket; differentiable at the place found."""

    def slope(at: Scalar) -> Scalar:
        return jax.jvp(function, (at,), (jnp.ones_like(at),))[1]

    def halve(_: int, bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        low, high = bracket
        middle = 0.5 * (low + high)
        rising = slope(middle) > 0.0
        return jnp.where(rising, middle, low), jnp.where(rising, high, middle)

    low, high = jax.lax.fori_loop(0, HALVINGS, halve, jax.lax.stop_gradient((low, high)))
    return function(jax.lax.stop_gradient(0.5 * (low + high)))
