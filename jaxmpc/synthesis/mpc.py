"""First move of the unconstrained MPC as three fixed rows of gains."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.quantities import HP_MAX, HU_MAX
from jaxmpc.synthesis.linear import solve

Scalar = Float[Array, ""]


def horizon_mask(horizon: Scalar, length: int, width: Scalar | float = 1.0) -> Float[Array, " length"]:
    """Weights of samples 1…length under a horizon: 1 inside, 0 outside, a ramp of `width` samples between.

    With width 1 a whole number gives the exact mask. A wider ramp lets a tuner feel the horizon; the
    first sample always counts.
    """
    i = jnp.arange(1, length + 1)
    ramp = jnp.clip((horizon - i) / width + 0.5 * (1.0 + 1.0 / width), 0.0, 1.0)
    return jnp.where(i == 1, 1.0, ramp)


def first_move(
    Phi: Float[Array, "n n"],
    Gamma: Float[Array, " n"],
    lam: Float[Array, " Hu_max"],
    delta: Float[Array, " Hp_max"],
    Hp: Scalar,
    Hu: Scalar,
    mask_width: Scalar | float = 1.0,
) -> tuple[Float[Array, " Hp_max"], Float[Array, " n"], Scalar]:
    r"""Gains of Δu = r·F_d − mₓ·x̂ − mᵤ u₋₁, the first row of the paper's (29).

        ΔU = (Θᵀ δ Θ + λ)⁻¹ Θᵀ δ (F_d − Ψ x̂ − Υ u₋₁),   output row C = [1 0 …] folded into Ψ, Υ, Θ

    The horizons are masks on δ and on the columns of Θ, so one compiled program serves every pair.
    A column weighted m < 1 acts as one whose move costs λ/m²: 1 is exact, 0 removes it.
    Erratum: eq. (21) prints D in the first row; it is B.

    Args:
        Phi: Transition matrix of the prediction model; its first state is the force.
        Gamma: Its input vector.
        lam: Diagonal of λ [-].
        delta: Diagonal of δ [-].
        Hp: Prediction horizon [samples].
        Hu: Control horizon [samples].
        mask_width: Softness of the horizons, 1 is exact [samples].

    Returns:
        r (zero beyond H_p), mₓ and mᵤ.
    """

    def predict(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        row, response = carry
        response = response + row @ Gamma
        row = row @ Phi
        return (row, response), (row, response)

    first = jnp.zeros(len(Phi)).at[0].set(1.0) + 0.0 * Gamma
    _, (Psi, step_response) = jax.lax.scan(predict, (first, 0.0 * Gamma[0]), length=HP_MAX)

    delay = jnp.arange(HP_MAX)[:, None] - jnp.arange(HU_MAX)[None, :]
    Theta = jnp.where(delay >= 0, step_response[jnp.maximum(delay, 0)], 0.0)
    Theta = Theta * horizon_mask(Hu, HU_MAX, mask_width)
    weighted = (delta * horizon_mask(Hp, HP_MAX, mask_width))[:, None] * Theta

    hessian = Theta.T @ weighted + jnp.diag(lam)
    first_row = solve(hessian, jnp.zeros((HU_MAX, 1)).at[0].set(1.0))[:, 0]
    mpc_ref = weighted @ first_row
    return mpc_ref, mpc_ref @ Psi, mpc_ref @ step_response
