"""Scalar functions for the lanes of a GPU: no number changes its precision, and sines of float32 call no library.

With the nearest multiple n of π taken off, r = x − nπ within ±π/2, one reduction serves both functions:

    sin x = (−1)ⁿ r (s₀ + s₁ r² + …),   cos x = (−1)ⁿ (c₀ + c₁ r² + …)

Coefficients by Remez' exchange: 3.3e-9 and 2.2e-10 from the truth, less than a float32 can tell. The sine of an angle
that is near another (`Ops.near`) is that one's, turned by their difference d, with d − d³/6 and 1 − d²/2 + d⁴/24.
"""

from collections.abc import Callable
from math import pi
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.law.ops import Ops
from jaxmpc.xla import ops

SINE_SERIES = (
    0.9999999765898829,
    -0.16666647634640208,
    0.008332899823359888,
    -0.00019800897763283166,
    2.5904885014815824e-06,
)
COSINE_SERIES = (
    0.9999999997806517,
    -0.4999999935847175,
    0.04166663625806955,
    -0.001388836140026659,
    2.4760161352095296e-05,
    -2.6051495205682994e-07,
)
COARSE = 3.140625
"""π to nine bits, so that a small multiple of it is exact in float32."""
LARGE = 1.5 * 2.0**23
"""What float32 counts by ones."""


Fused = Callable[[Any, Any, Any], Any]
"""a·b + c."""

SINE, COSINE, NEAR = "_lane_sine", "_lane_cosine", "_lane_near"
"""Names of the three functions below, by which a step that is taken apart knows what it calls."""


@jax.jit
def _lane_sine(angle: Any) -> Any:
    return sines(angle)[0]


@jax.jit
def _lane_cosine(angle: Any) -> Any:
    return sines(angle)[1]


@jax.custom_jvp
def _sin(angle: Any) -> Any:
    return _lane_sine(angle)


@jax.custom_jvp
def _cos(angle: Any) -> Any:
    return _lane_cosine(angle)


# Each has the other, which is there anyway, as its slope, and not that of a polynomial.
_sin.defjvp(lambda at, along: (_sin(*at), _cos(*at) * along[0]))
_cos.defjvp(lambda at, along: (_cos(*at), -_sin(*at) * along[0]))


@jax.jit
def _lane_near(angle: Any, other: Any) -> Any:
    return angle


@jax.custom_jvp
def _near(angle: Any, other: Any) -> Any:
    return _lane_near(angle, other)


# Whatever the other angle does, this one stays what it is; and of a tangent nobody takes the sine.
_near.defjvp(lambda at, along: (_near(*at), along[0]))


def plainly_fused(one: Any, other: Any, rest: Any) -> Any:
    """a·b + c, which a processor may round once."""
    return one * other + rest


def sines(angle: Any, fused: Fused = plainly_fused) -> tuple[Any, Any]:
    """Sine and cosine of an angle [rad]."""
    n = jnp.floor(fused(angle, 1.0 / pi, 0.5))
    # Beside a number so large, whether n is odd stands in the last bit, which becomes the sign's.
    sign = jnp.left_shift(jax.lax.bitcast_convert_type(jnp.asarray(n + LARGE, jnp.float32), jnp.int32), 31)
    r = fused(n, -(pi - COARSE), fused(n, -COARSE, angle))
    square = r * r
    return _signed(sign, r * _even(SINE_SERIES, square, fused)), _signed(sign, _even(COSINE_SERIES, square, fused))


def turned(sine: Any, cosine: Any, change: Any, fused: Fused = plainly_fused) -> tuple[Any, Any]:
    """Sine and cosine of an angle that differs by up to 0.1 rad from one whose are known."""
    square = change * change
    s, c = change * fused(square, -1.0 / 6.0, 1.0), square * fused(square, 1.0 / 24.0, -0.5)
    return fused(sine, c, fused(cosine, s, sine)), fused(cosine, c, fused(-sine, s, cosine))


def _signed(sign: Any, value: Any) -> Any:
    bits = jax.lax.bitcast_convert_type(value, jnp.int32)
    return jax.lax.bitcast_convert_type(jnp.bitwise_xor(bits, sign), jnp.float32)


def _even(coefficients: tuple[float, ...], square: Any, fused: Fused) -> Any:
    total: Any = coefficients[-1]
    for each in reversed(coefficients[:-1]):
        total = fused(total, square, each)
    return total


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
    sin: Any = staticmethod(jnp.sin)
    cos: Any = staticmethod(jnp.cos)
    sqrt, exp, log = staticmethod(ops.sqrt), staticmethod(ops.exp), staticmethod(ops.log)
    maximum, minimum, clip = staticmethod(_maximum), staticmethod(_minimum), staticmethod(_clip)
    floor, replaced = staticmethod(ops.floor), staticmethod(ops.replaced)
    near: Any = staticmethod(ops.near)

    def where(self, condition: Any, this: Any, that: Any) -> Any:
        # Two plain numbers have no precision of their own, and would take that of the process.
        if isinstance(this, float) and isinstance(that, float):
            this, that = jnp.asarray(this, self.dtype), jnp.asarray(that, self.dtype)
        return jnp.where(condition, this, that)


class _Float32(_Float64):
    dtype = jnp.float32

    sin, cos, near = staticmethod(_sin), staticmethod(_cos), staticmethod(_near)


_BY_PRECISION: dict[Any, Ops] = {jnp.dtype(kind.dtype): kind() for kind in (_Float32, _Float64)}


def lane_ops(dtype: Any) -> Ops:
    """The functions for a precision."""
    return _BY_PRECISION[jnp.dtype(dtype)]
