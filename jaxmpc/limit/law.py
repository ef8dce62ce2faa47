"""A linear law in state space: what the limit hands out."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxmpc.limit.plant import AxisPlant


class LinearLaw(NamedTuple):
    """From the residual e = y − F_d to the command v: sₖ₊₁ = A sₖ + B eₖ,  vₖ = C sₖ + D eₖ."""

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, " n"]
    C: Float[np.ndarray, " n"]
    D: float


def response(law: LinearLaw, theta: Float[np.ndarray, " angles"]) -> Complex[np.ndarray, " angles"]:
    """V/E at angles θ = ω T_s [m/s²/N]."""
    answer: Complex[np.ndarray, " angles"] = transfer(law.A, law.B[:, None], law.C[None], theta)[:, 0, 0] + law.D
    return answer


def transfer(A: np.ndarray, B: np.ndarray, C: np.ndarray, theta: np.ndarray) -> Complex[np.ndarray, "angles out in"]:
    """C (z − A)⁻¹ B at z = e^{jθ}: S⁻¹ A S = U T Uᴴ once, and for all angles together T from below."""
    from scipy.linalg import matrix_balance, schur

    # States of micrometres beside states of newtons would leave the small ones no digits.
    balanced, S = matrix_balance(A, permute=False)
    T, U = schur(balanced, output="complex")
    z, sent = np.exp(1j * theta), U.conj().T @ (B / np.diag(S)[:, None])
    states = np.empty((*sent.shape, len(z)), complex)
    for row in reversed(range(len(A))):
        below = np.tensordot(T[row, row + 1 :], states[row + 1 :], axes=1)
        states[row] = (sent[row][:, None] + below) / (z - T[row, row])
    answer: Complex[np.ndarray, "angles out in"] = np.einsum("on,nia->aoi", C @ S @ U, states)
    return answer


def spectral_radius_of(law: LinearLaw, plant: AxisPlant) -> float:
    """Largest magnitude of an eigenvalue of the closed loop [-]."""
    plant_part = np.hstack([plant.A + law.D * np.outer(plant.B, plant.C), np.outer(plant.B, law.C)])
    law_part = np.hstack([np.outer(law.B, plant.C), law.A])
    return float(np.abs(np.linalg.eigvals(np.vstack([plant_part, law_part]))).max())
