"""The two models that the design works on: the contact as the observer sees it, and the wanted closed loop."""

from math import factorial
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def contact_model(Khat_s: Scalar, K2: Scalar, T_s: Any) -> tuple[Float[Array, "2 2"], Float[Array, "2"]]:
    r"""Zero-order hold of the contact, paper (8), without its delay.

        d/dt [y, ẏ] = [[0, 1], [0, −K₂]] [y, ẏ] + [0, K̂_s] v

    Args:
        Khat_s: Assumed stiffness K̂_s [N/m].
        K2: Damping K₂ [1/s].
        T_s: Sampling time [s].

    Returns:
        Φ₂ and Γ₂ of y = force [N], ẏ = force rate [N/s], v = acceleration [m/s²].
    """
    first, second = hold_integrals(K2, T_s)
    Phi = jnp.array([[1.0, 0.0], [0.0, 1.0]]) + jnp.stack(
        [jnp.stack([0.0 * first, first]), jnp.stack([0.0 * K2, -K2 * first])]
    )
    return Phi, Khat_s * jnp.stack([second, first])


def hold_integrals(K2: Scalar, T_s: Any) -> tuple[Scalar, Scalar]:
    r"""∫e^(−K₂t)dt and its integral over one sample, exact down to K₂ = 0.

    With z = K₂T the closed forms T(1 − e^(−z))/z and T²(z − 1 + e^(−z))/z² lose their digits for
    small z, so below 0.5 the series Σ(−z)ᵏ/(k+1)! and Σ(−z)ᵏ/(k+2)! take over.

    Returns:
        First integral [s] and second integral [s²].
    """
    z = K2 * T_s
    series_1 = jnp.polyval(jnp.array([(-1.0) ** k / factorial(k + 1) for k in range(15, -1, -1)]), z)
    series_2 = jnp.polyval(jnp.array([(-1.0) ** k / factorial(k + 2) for k in range(15, -1, -1)]), z)
    small = z < 0.5
    safe = jnp.where(small, 1.0, z)
    first = jnp.where(small, series_1, -jnp.expm1(-safe) / safe)
    second = jnp.where(small, series_2, (safe + jnp.expm1(-safe)) / safe**2)
    return T_s * first, T_s**2 * second


def closed_loop_model(T_cl: Scalar, T_s: Any) -> tuple[Float[Array, "2 2"], Float[Array, "2"]]:
    r"""Zero-order hold of the wanted closed loop, paper (10) and (15), its delay left out as there.

        G_cl = 1 / (1 + T_cl s)²,  state [y, ẏ]

    Args:
        T_cl: Time constant [s].
        T_s: Sampling time [s].

    Returns:
        A and B of y = force [N], ẏ = force rate [N/s], u = force reference [N].
    """
    a = 1.0 / T_cl
    z = a * T_s
    decay = jnp.exp(-z)
    A = decay * jnp.stack([jnp.stack([1.0 + z, T_s + 0.0 * z]), jnp.stack([-a * z, 1.0 - z])])
    B = jnp.stack([1.0 - (1.0 + z) * decay, a * z * decay])
    return A, B
