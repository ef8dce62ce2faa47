"""Leading dimensions of a tree of arrays: what is no program's own part is done by numpy, which compiles nothing."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.xla.place import placed

Tree = TypeVar("Tree")


def traced(tree: Any) -> bool:
    """Whether a program is being made of it."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def reshaped(tree: Tree, leading: int, *shape: int) -> Tree:
    """With other leading dimensions.

    Args:
        tree: Of arrays.
        leading: How many dimensions are replaced.
        *shape: Those that come instead; of one that is -1 the size follows.
    """

    def reshape(leaf: Any) -> Any:
        if isinstance(leaf, jax.core.Tracer):
            return leaf.reshape((*shape, *leaf.shape[leading:]))
        values = np.asarray(leaf)
        return placed(values.reshape((*shape, *values.shape[leading:])))

    found: Tree = jax.tree.map(reshape, tree)
    return found


def repeated(tree: Tree, count: int) -> Tree:
    """Every row so many times, one after another."""

    def repeat(leaf: Any) -> Any:
        if isinstance(leaf, jax.core.Tracer):
            return jnp.repeat(leaf, count, axis=0)
        return np.repeat(np.asarray(leaf), count, axis=0)

    found: Tree = jax.tree.map(repeat, tree)
    return found
