"""Scalar functions for the lanes of a GPU: no number changes its precision, and sines of float32 call no library.

With the nearest multiple n of π taken off, r = x − nπ within ±π/2, one reduction serves both functions:

    sin x = (−1)ⁿ r (s₀ + s₁ r² + …),   cos x = (−1)ⁿ (c₀ + c₁ r² + …)

Coefficients by Remez' exchange: 3.3e-9 and 2.2e-10 from the truth, less than a float32 can tell.
"""

from math import pi
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.law.ops import Ops
from jaxmpc.xla import ops

SINE = 0.9999999765898829, -0.16666647634640208, 0.008332899823359888, -0.00019800897763283166, 2.5904885014815824e-06
COSINE = (
    0.9999999997806517,
    -0.4999999935847175,
    0.04166663625806955,
    -0.001388836140026659,
    2.4760161352095296e-05,
    -2.6051495205682994e-07,
)
COARSE = 3.140625
"""π to nine bits, so that a small multiple of it is exact in float32."""


@jax.custom_jvp
def _maximum(one: Any, other: Any) -> Any:
    return jnp.maximum(one, other)


@jax.custom_jvp
def _minimum(one: Any, other: Any) -> Any:
    return jnp.minimum(one, other)


@_maximum.defjvp
def _maximum_jvp(at: tuple[Any, Any], along: tuple[Any, Any]) -> tuple[Any, Any]:
    # JAX halves both slopes where both are equal: six instructions for what any one of them answers as well.
    return jnp.maximum(*at), jnp.where(at[0] >= at[1], *along)


@_minimum.defjvp
def _minimum_jvp(at: tuple[Any, Any], along: tuple[Any, Any]) -> tuple[Any, Any]:
    return jnp.minimum(*at), jnp.where(at[0] <= at[1], *along)


def _clip(value: Any, low: Any, high: Any) -> Any:
    return _minimum(_maximum(value, low), high)


class _Float64:
    """The functions of `jaxmpc.xla.ops`, whose precision plain numbers follow."""

    dtype: Any = jnp.float64
    sin, cos = staticmethod(jnp.sin), staticmethod(jnp.cos)
    sqrt, exp, log = staticmethod(ops.sqrt), staticmethod(ops.exp), staticmethod(ops.log)
    maximum, minimum, clip = staticmethod(_maximum), staticmethod(_minimum), staticmethod(_clip)
    floor, replaced = staticmethod(ops.floor), staticmethod(ops.replaced)

    def where(self, condition: Any, this: Any, that: Any) -> Any:
        # Two plain numbers have no precision of their own, and would take that of the process.
        if isinstance(this, float) and isinstance(that, float):
            this, that = jnp.asarray(this, self.dtype), jnp.asarray(that, self.dtype)
        return jnp.where(condition, this, that)


@jax.custom_jvp
def _sin(angle: Any) -> Any:
    sign, r = _reduced(angle)
    return sign * r * _even(SINE, r * r)


@jax.custom_jvp
def _cos(angle: Any) -> Any:
    sign, r = _reduced(angle)
    return sign * _even(COSINE, r * r)


# Each has the other, which is there anyway, as its slope, and not that of a polynomial.
_sin.defjvp(lambda at, along: (_sin(*at), _cos(*at) * along[0]))
_cos.defjvp(lambda at, along: (_cos(*at), -_sin(*at) * along[0]))


class _Float32(_Float64):
    dtype = jnp.float32
    sin, cos = staticmethod(_sin), staticmethod(_cos)


def _reduced(angle: Any) -> tuple[Any, Any]:
    """(−1)ⁿ and the angle without nπ."""
    n = jnp.floor(angle * (1.0 / pi) + 0.5)
    odd = n - 2.0 * jnp.floor(0.5 * n)
    return 1.0 - 2.0 * odd, angle - n * COARSE - n * (pi - COARSE)


def _even(coefficients: tuple[float, ...], square: Any) -> Any:
    total: Any = coefficients[-1]
    for each in reversed(coefficients[:-1]):
        total = total * square + each
    return total


_BY_PRECISION: dict[Any, Ops] = {jnp.dtype(kind.dtype): kind() for kind in (_Float32, _Float64)}


def lane_ops(dtype: Any) -> Ops:
    """The functions for a precision."""
    return _BY_PRECISION[jnp.dtype(dtype)]
