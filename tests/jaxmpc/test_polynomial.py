"""Polynomials of traced coefficients are numpy's."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial as Peer

from jaxmpc.stability.polynomial import Polynomial, value

COEFFICIENTS = np.random.default_rng(0).standard_normal((3, 4))


def combined(kind: Any, rows: Any) -> Any:
    """Every operation; the powers left out, ones and minus ones are what the response has most of."""
    one, two, three = (kind(*row) if kind is Polynomial else kind(row) for row in rows)
    d, q = (kind(0.0, 1.0), kind(1.0, -1.0)) if kind is Polynomial else (kind([0.0, 1.0]), kind([1.0, -1.0]))
    gain = rows[0][0]
    return q * (one * two - gain * three) + d * (1.0 - two * q) + (gain - one) * 2.0 + 0.0 * d


def test_arithmetic_is_numpys() -> None:
    found = jax.jit(lambda rows: combined(Polynomial, rows).coefficients)(COEFFICIENTS)
    expected = combined(Peer, COEFFICIENTS)
    np.testing.assert_allclose(found, expected.coef, rtol=1e-13, atol=1e-14)
    at = np.exp(-1j * np.linspace(0.0, np.pi, 9))
    np.testing.assert_allclose(value(found, jnp.asarray(at)), expected(at), rtol=1e-13)


def test_what_changes_nothing_is_no_operation() -> None:
    """Of every product with q = 1 − d half is left."""
    traced = jax.make_jaxpr(lambda c: (Polynomial(1.0, -1.0) * Polynomial(0.0, c)).coefficients)(2.0)
    assert [equation.primitive.name for equation in traced.eqns] == ["mul"]


@pytest.mark.parametrize("gain", [np.float64(3.0), np.asarray(3.0), jnp.asarray(3.0)], ids=["scalar", "array", "jax"])
def test_a_gain_from_the_left_is_one_from_the_right(gain: Any) -> None:
    for product in (gain * Polynomial(1.0, 2.0), Polynomial(1.0, 2.0) * gain):
        np.testing.assert_array_equal(product.coefficients, [3.0, 6.0])
