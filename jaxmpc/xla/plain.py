"""NumPy for plain arrays, JAX for its own: what is worked out once, of a few numbers, needs no program."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def library(*values: Any) -> Any:
    """`jax.numpy` where any leaf is JAX's, traced or not, else `numpy`."""
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)) else np
