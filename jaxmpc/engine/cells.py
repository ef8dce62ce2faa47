"""One function of one axis, run over controllers × stiffnesses × axes."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.engine.rollout import AxisSignals
from jaxmpc.law.cascade import Gains
from jaxmpc.world.contact import Contact


def over_cells(function: Callable[..., Any], gains: Gains, contacts: Contact, lsb: Any, signals: AxisSignals) -> Any:
    """f(gains, contact, lsb, signals) for every cell of a batch.

    Controllers are the innermost dimension of the computation: they alone differ in everything and are
    many, so each operation runs over contiguous memory (three axes innermost cost a factor of three).

    Args:
        function: `run` or `record` of the rollout.
        gains: Taken apart into scalars, each (controllers,).
        contacts: Each (controllers, stiffnesses).
        lsb: Quantisation per axis, (3,) [N].
        signals: Axis first, (3, steps, …); its acceleration may be None.

    Returns:
        What the function returns, with leading dimensions (controllers, stiffnesses, 3).
    """
    over_controllers = jax.vmap(function, in_axes=(0, 0, None, None))
    over_axes = jax.vmap(over_controllers, in_axes=(None, None, 0, 0))
    over_stiffness = jax.vmap(over_axes, in_axes=(None, 1, None, None))
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 2, 0), over_stiffness(gains, contacts, lsb, signals))
