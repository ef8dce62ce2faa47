"""Float64 where the mathematics needs it, without touching the user's configuration."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.xla.rows import traced

P = ParamSpec("P")
R = TypeVar("R")


def in_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run a public function with 64-bit JAX, whatever the caller's setting.

    Design and margins lose their digits in float32 (the Riccati equation up to all of them), so they
    always run in float64. To differentiate through them, switch 64-bit on for your own code too:
    `jax.config.update("jax_enable_x64", True)`.

    Raises:
        InputError: An argument is traced by a program of 32 bits.
    """

    @functools.wraps(function)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        caller_has_float64 = jnp.result_type(float) == jnp.float64
        if not caller_has_float64 and traced((args, kwargs)):
            remedy = 'jax.config.update("jax_enable_x64", True) at the start of your program.'
            raise InputError("jax_enable_x64", False, "on where you differentiate, jit or vmap", remedy)
        with jax.enable_x64(True):
            result = function(*args, **kwargs)
        # A 32-bit caller's JAX would round 64-bit arrays at their next use; numpy keeps them.
        return result if caller_has_float64 else jax.tree.map(_on_host, result)

    return wrapper


def _on_host(leaf: Any) -> Any:
    concrete = isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer)
    return np.asarray(leaf) if concrete else leaf
