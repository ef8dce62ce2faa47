"""State feedback that gives the contact loop the wanted poles."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def state_feedback(Phi: Float[Array, "2 2"], Gamma: Float[Array, "2"], T_cl: Scalar, T_s: Any) -> Float[Array, "3"]:
    r"""L_r that puts the poles of Φᵣ − Γᵣ L_r at e^(−T_s/T_cl), twice, and at 0, paper (10) and (30).

    The delayed plant is Φᵣ = [[Φ₂, Γ₂], [0, 0]], Γᵣ = [0, 0, 1]ᵀ. Ackermann's formula on it reads

        L_r = [ℓ φ(Φ₂), L₃]  with  ℓ = [0 1] [Γ₂, Φ₂Γ₂]⁻¹,  φ(z) = z² + a₁z + a₂,

    because the third pole at 0 leaves (Φ₂ − Γ₂ ℓ_d) placed by the two others, one sample later.

    Returns:
        L_r for force [m/s²/N], force rate [m/s/N] and delayed input [-].
    """
    pole = jnp.exp(-T_s / T_cl)
    determinant = Gamma[0] * (Phi[1] @ Gamma) - Gamma[1] * (Phi[0] @ Gamma)
    last_row = jnp.stack([-Gamma[1], Gamma[0]]) / determinant
    placed = Phi @ Phi - 2.0 * pole * Phi + pole**2 * jnp.eye(2)
    undelayed = last_row @ placed
    return jnp.concatenate([undelayed @ Phi, (undelayed @ Gamma)[None]])
