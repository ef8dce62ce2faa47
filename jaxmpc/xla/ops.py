"""What the law and the world need besides + - * /, on JAX scalars; steps are straight-through in the tangent.

The true derivative of a quantiser is zero and that of a drive's saturation drops to zero: both would hide the loop from
a tuner. `floor` and `replaced` have that of the identity; `clip`, of which the law decides, has its own.
"""

from typing import Any

import jax
import jax.numpy as jnp

exp, log, sqrt, where = jnp.exp, jnp.log, jnp.sqrt, jnp.where
maximum, minimum = jnp.maximum, jnp.minimum


@jax.custom_jvp
def sin(angle: Any) -> Any:
    """Sine, computed once however often it is used."""
    return _kept(jnp.sin(angle))


@jax.custom_jvp
def cos(angle: Any) -> Any:
    """Cosine, computed once however often it is used."""
    return _kept(jnp.cos(angle))


@sin.defjvp
def _sin_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return sin(*primals), cos(*primals) * tangents[0]


@cos.defjvp
def _cos_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return cos(*primals), -sin(*primals) * tangents[0]


def _kept(value: Any) -> Any:
    """The same value, divided by a one that the compiler cannot see through.

    XLA on a CPU copies most operations into every fusion that needs them: the 24 sines and cosines of a step were
    computed 361 times, which was all of its time. A quotient is one of the few results that it keeps.
    """
    return value / (1.0 + 0.0 * value)


@jax.custom_jvp
def floor(value: Any) -> Any:
    """Largest whole number not above a value."""
    return jnp.floor(value)


@floor.defjvp
def _floor_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return jnp.floor(primals[0]), tangents[0]


def clip(value: Any, low: Any, high: Any) -> Any:
    """A value held within two limits."""
    return jnp.minimum(jnp.maximum(value, low), high)


def near(angle: Any, other: Any) -> Any:
    """An angle that is near another, which is of use to whoever computes sines by hand."""
    return angle


@jax.custom_jvp
def replaced(value: Any, new: Any) -> Any:
    """Another value in the place of one, whose slope stays."""
    return new


@replaced.defjvp
def _replaced_jvp(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
    return replaced(*primals), tangents[0]
