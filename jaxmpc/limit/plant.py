"""One axis of the world as matrices, built by running the world itself."""

from typing import Any, NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmpc.world.contact import Contact, init, move, sense


class AxisPlant(NamedTuple):
    """State x of a contact from sample to sample, command v in, force y out; d is (heart, acceleration, noise).

    xₖ₊₁ = A xₖ + B vₖ + E dₖ,   yₖ = C xₖ + D dₖ,   aₖ = vₖ + Cₐ xₖ + Dₐ dₖ
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, " n"]
    E: Float[np.ndarray, "n 3"]
    C: Float[np.ndarray, " n"]
    D: Float[np.ndarray, "3"]
    C_a: Float[np.ndarray, " n"]
    D_a: Float[np.ndarray, "3"]


def plant_of(contact: Contact) -> AxisPlant:
    """The matrices of one world; needs 64-bit JAX."""
    flat, restore = jax.flatten_util.ravel_pytree(init(jnp.asarray(0.0)))
    n = len(flat)

    def advance(everything: Any) -> Any:
        heart, acceleration, noise, v = everything[n:]
        force, state = sense(contact, restore(everything[:n]), heart)
        following, a = move(contact, state, v, acceleration)
        return jnp.concatenate([jax.flatten_util.ravel_pytree(following)[0], jnp.stack([force + noise, a])])

    whole = np.asarray(jax.jacfwd(advance)(jnp.zeros(n + 4)))
    return AxisPlant(
        A=whole[:n, :n],
        B=whole[:n, -1],
        E=whole[:n, n:-1],
        C=whole[n, :n],
        D=whole[n, n:-1],
        C_a=whole[n + 1, :n],
        D_a=whole[n + 1, n:-1],
    )
