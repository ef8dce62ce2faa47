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
    """C (z − A)⁻¹ B at z = e^{jθ}."""
    z = np.exp(1j * theta)
    states = np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape)))
    answer: Complex[np.ndarray, "angles out in"] = C @ states
    return answer


def spectral_radius_of(law: LinearLaw, plant: AxisPlant) -> float:
    """Largest magnitude of an eigenvalue of the closed loop [-]."""
    plant_part = np.hstack([plant.A + law.D * np.outer(plant.B, plant.C), np.outer(plant.B, law.C)])
    law_part = np.hstack([np.outer(law.B, plant.C), law.A])
    return float(np.abs(np.linalg.eigvals(np.vstack([plant_part, law_part]))).max())
