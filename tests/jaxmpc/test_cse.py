"""Intermediate values shared by dividing by one: the same numbers and slopes, in the places that are worth it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.xla.cse import COPIED, sharing

ONE = jnp.asarray(1.0)


def costly(x: Any) -> Any:
    """More additions than are copied, of which the result is used twice."""
    total = x
    for _ in range(COPIED + 1):
        total = total + x * x
    return jnp.sin(total), total * total


def cheap(x: Any) -> Any:
    total = x + x * x
    return jnp.sin(total), total * total


def divisions(function: Any) -> int:
    jaxpr = jax.make_jaxpr(lambda x, one: sharing(function, one)(x))(0.3, ONE)
    return sum(equation.primitive.name == "div" for equation in jaxpr.eqns)


def test_values_and_slopes_stay() -> None:
    x = jnp.linspace(0.1, 0.4, 7)
    for function in (costly, cheap):
        np.testing.assert_array_equal(sharing(function, ONE)(x), function(x))
        slope = jax.grad(lambda x, f=function: jnp.sum(sharing(f, ONE)(x)[1]))(x)
        np.testing.assert_allclose(slope, jax.grad(lambda x, f=function: jnp.sum(f(x)[1]))(x), rtol=1e-12)


def test_what_is_costly_and_used_twice_is_shared() -> None:
    assert divisions(costly) == 1
    assert divisions(cheap) == 0


def test_a_program_within_the_program_is_run_by_jax() -> None:
    def nested(x: Any) -> Any:
        return jax.lax.cond(x > 0.0, jnp.sin, jnp.cos, x), jax.jit(jnp.tanh)(x)

    np.testing.assert_array_equal(sharing(nested, ONE)(jnp.asarray(0.3)), nested(jnp.asarray(0.3)))
