"""Frequency response of the controller, in closed form.

The law's equations are triangular in the z-domain, so its transfer function needs no matrix at all.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex

from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gains import Gains
from jaxmpc.stability import held_beat
from jaxmpc.stability.held_beat import HeldBeat
from jaxmpc.stability.polynomial import Coefficients, Polynomial, value

Response = Complex[Array, "..."]


class TransferFunction(NamedTuple):
    """V/Y of the cascade as a ratio of polynomials in d = 1 − z⁻¹; one of order N has N + 4 and five coefficients."""

    upper: Coefficients
    """f_I, see `controller_of` [m/s²/N]."""
    lower: Coefficients
    """What is in its braces [-]."""
    beat: Coefficients | None
    """g ρ Y_I, which times R is added to f_I [m/s²/N]; None learns nothing of the beat."""
    force_filter: ForceFilter | None
    """What filters the measured force before all else."""


def controller_of(gains: Gains, learns: bool = False) -> TransferFunction:
    r"""V/Y of the cascade [m/s²/N], without a division before the last but one.

    Every signal is a combination of the innovation I and the command V. At q = z⁻¹, with the disturbance order N,
    d = 1 − q, e = 1 − φ₂₂ q, m = 1 − (1 − mᵤ) q the law's equations, from the observer's last state to its first, read

        dᴺ P̂ = n_p I,  dᴺ X̂₃ = n₃ I + q dᴺ V,  e dᴺ X̂₂ = n₂ I + γ₂ q² dᴺ V,  e dᴺ⁺¹ X̂₁ = n₁ I + q² dᴺ b V,

    Y = X̂₁ + (1 − K₁) I, and V = −(L₁ + g m₁/m) X̂₁ − (L₂ + g m₂/m) X̂₂ − L₃ X̂₃ − P̂. Without I, and
    with wᵢ = m Lᵢ + g mᵢ and f_I I + f_V V what the law makes of both,

        V/Y = f_I / (dᴺ {q² w₂ (γ₁ K₂ − γ₂ K₁) − m [q b K₃ + (1 + q L₃)(q φ₁₂ K₂ + e K₁)] − (1 − K₁)(m e d + f_V)}),

    after e dᴺ⁺¹ has cancelled out: so the N integrators keep their digits down to any frequency.

    Where commands act after two samples, Ŵ acts where X̂₃ does above, and X̃ = (X̂ − K I)/q is in the place of X̂ in V:

        dᴺ Ŵ = n_w I + q² dᴺ V,  n_w = q n₃ + K_w dᴺ,
        e dᴺ X̃₂ = (γ₂ n_w + K₂ φ₂₂ dᴺ) I + γ₂ q² dᴺ V,  e dᴺ⁺¹ X̃₁ = (b n_w + (φ₁₂ K₂ + e K₁) dᴺ) I + q² dᴺ b V,
        V/Y = f_I / (dᴺ {q² [w₂ (K₂ (γ₁ − b) − γ₂ K₁) − w₁ b K₁] − (1 − K₁)(m e d + f_V)
                         − m [q² b K₃ + (1 + q L₃)(q b K_w + q φ₁₂ K₂ + e K₁)]}).

    Where beats are learned (`held_beat`), −R Y is added to the wanted force, and ρ = Σ rᵢ times g to m V. In place of
    f_I then stands f_I + g ρ R Y_I, with Y_I = n₁ + (1 − K₁) e dᴺ⁺¹, or q n₁ + e dᴺ⁺¹ where commands act later.

    Args:
        gains: One controller; traceable, differentiable.
        learns: Whether it learns the beat.
    """
    (phi_12, phi_22), (gamma_1, gamma_2) = gains.phi, gains.gamma
    K_1, K_2, K_3, *K_p = (gains.K[i] for i in range(len(gains.K)))
    d, q = Polynomial(0.0, 1.0), Polynomial(1.0, -1.0)
    e, m = 1.0 - phi_22 * q, 1.0 - (1.0 - gains.mpc_u) * q
    n_p, integrators = Polynomial(K_p[-1]), d
    for gain in K_p[-2::-1]:
        n_p, integrators = q * n_p + gain * integrators, d * integrators
    n_3 = q * n_p + K_3 * integrators
    b = phi_12 * gamma_2 * q + gamma_1 * e
    if gains.K_earlier is None:
        n_2 = gamma_2 * q * n_3 + K_2 * integrators
        n_1 = q * (phi_12 * n_2 + gamma_1 * e * n_3) + K_1 * e * integrators
    else:
        n_w = q * n_3 + gains.K_earlier * integrators
        n_2 = gamma_2 * n_w + K_2 * phi_22 * integrators
        n_1 = b * n_w + (phi_12 * K_2 + e * K_1) * integrators

    weight_1 = m * gains.L[0] + gains.input_gain * gains.mpc_x[0]
    weight_2 = m * gains.L[1] + gains.input_gain * gains.mpc_x[1]
    from_I = weight_1 * n_1 + d * (weight_2 * n_2 + m * e * (gains.L[2] * n_3 + n_p))
    from_V = q * (weight_1 * q * b + d * (weight_2 * gamma_2 * q + gains.L[2] * m * e))
    if gains.K_earlier is None:
        rest = q * q * weight_2 * (gamma_1 * K_2 - gamma_2 * K_1) - (1.0 - K_1) * (m * e * d + from_V)
        rest = rest - m * (q * b * K_3 + (1.0 + q * gains.L[2]) * (q * phi_12 * K_2 + e * K_1))
    else:
        rest = q * q * (weight_2 * (K_2 * (gamma_1 - b) - gamma_2 * K_1) - weight_1 * b * K_1)
        rest = rest - (1.0 - K_1) * (m * e * d + from_V)
        late = q * b * gains.K_earlier + q * phi_12 * K_2 + e * K_1
        rest = rest - m * (q * q * b * K_3 + (1.0 + q * gains.L[2]) * late)
    beat = None
    if learns:
        late, kept = (1.0, 1.0 - K_1) if gains.K_earlier is None else (q, 1.0)
        beat = gains.input_gain * jnp.sum(gains.mpc_ref) * (late * n_1 + kept * e * d * integrators)
    # Else XLA computes them anew in every loop over angles.
    once: Any = jax.lax.optimization_barrier
    upper, lower, added = once((from_I.coefficients, rest.coefficients, beat and beat.coefficients))
    return TransferFunction(upper, lower, added, gains.force_filter)


def controller_response(gains: Gains, q: Response, held: HeldBeat | None = None) -> Response:
    """V/Y of the cascade at q = z⁻¹ [m/s²/N]; see `controller_of`."""
    return answer(controller_of(gains, held is not None), q, held)


def answer(controller: TransferFunction, q: Response, held: HeldBeat | None = None) -> Response:
    """V/Y of a controller at q = z⁻¹ [m/s²/N].

    Args:
        controller: It.
        q: Where.
        held: What it has learned of the beat; None learns nothing.
    """
    d, upper, order = 1.0 - q, controller.upper, len(controller.upper) - 4
    from_I = value(upper, d)
    if controller.beat is not None and held is not None:
        from_I = from_I + value(controller.beat, d) * held_beat.response(held, q)
    response: Response = from_I / (d**order * value(controller.lower, d))
    return response if controller.force_filter is None else response * filter_response(controller.force_filter, q)


def filter_response(force_filter: ForceFilter, q: Response) -> Response:
    r"""Ŷ/Y of the filter of the measured force at q = z⁻¹ [-].

    With d = 1 − q: (K_y d + q K_r T_s)/(d² + q (K_y d + K_r T_s)).
    """
    d, of_rate = 1.0 - q, force_filter.rate_gain * force_filter.T_s
    of_force = force_filter.force_gain * d
    response: Response = (of_force + q * of_rate) / (d * d + q * (of_force + of_rate))
    return response
