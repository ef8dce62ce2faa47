"""Small linear systems without LAPACK.

LAPACK calls inside a batched program split their work over the thread pool that runs them and wait for it:
two of them at once on two cores wait for each other for ever (seen with jaxlib 0.10.2). Plain array
operations cannot, are several times faster at these sizes, and run on every device.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def solve(A: Float[Array, "n n"], B: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """A⁻¹B by Gauss–Jordan elimination with partial pivoting; differentiates as the linear solve that it is.

    Args:
        A: Square matrix, a few dozen rows at most.
        B: Right-hand sides.

    Returns:
        The solution; NaN or infinite where A is singular.
    """
    solution: Array = jax.lax.custom_linear_solve(
        lambda X: A @ X,
        B,
        solve=lambda _, right: _eliminate(A, right),
        transpose_solve=lambda _, right: _eliminate(A.T, right),
    )
    return solution


def _eliminate(A: Float[Array, "n n"], B: Float[Array, "n m"]) -> Float[Array, "n m"]:
    rows = jnp.arange(len(A))

    def column(k: Any, table: Array) -> Array:
        candidates = jnp.where(rows >= k, jnp.abs(table[:, k]), -1.0)
        pivot = jnp.argmax(candidates)
        swapped = jnp.where(rows == k, pivot, jnp.where(rows == pivot, k, rows))
        table = table[swapped]
        chosen = table[k] / table[k, k]
        factors = jnp.where(rows == k, 0.0, table[:, k])
        return jnp.where((rows == k)[:, None], chosen, table - factors[:, None] * chosen)

    table: Array = jax.lax.fori_loop(0, len(A), column, jnp.concatenate([A, B], axis=1))
    return table[:, len(A) :]
