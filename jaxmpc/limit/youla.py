r"""All linear laws that hold a loop stable, as one stable filter Q (Youla, Jabr, Bongiorno, IEEE TAC 21, 1976).

An observer of the plant and of a constant push p at its input, with innovation ε = e − C x̂, and a state feedback

    v = −K x̂ − p̂ + Q ε,   x̂ₖ₊₁ = A x̂ₖ + B (vₖ + p̂ₖ) + L ε,   p̂ₖ₊₁ = p̂ₖ + L_p ε

are a law that stabilises for every stable Q, and every law with integral action that stabilises is one of them. What
disturbs the loop reaches ε whatever Q is, so that every signal of the loop is z = (T₁ + T₂ Q T₃) d: affine in Q.
Q is a sum of Laguerre functions with the pole a, their weights q:

    Q = q₀ + Σₖ qₖ √(1 − a²)/(z − a) ((1 − a z)/(z − a))^(k−1)
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxmpc.limit.law import LinearLaw, transfer
from jaxmpc.limit.plant import AxisPlant

BANDWIDTH = 10.0
"""Where the closed loop of observer and feedback has its poles [rad/s]: slow, since Q can hasten but not slow down."""
DECAY = 4.5e-3
"""Time constant of the Laguerre functions' pole [s]: 35 Hz, about where these loops cross over."""


class Stabiliser(NamedTuple):
    """Observer and feedback around which Q is added."""

    feedback: Float[np.ndarray, " n"]
    """K"""
    observer: Float[np.ndarray, " n1"]
    """L, that of the push last."""


class Affine(NamedTuple):
    """A signal at some angles, per disturbance: `base` + `per_weight` @ q."""

    base: Complex[np.ndarray, "angles 3"]
    per_weight: Complex[np.ndarray, "angles 3 weights"]


def stabiliser(plant: AxisPlant, stiffness: float, T_s: float) -> Stabiliser:
    """Feedback and observer with all poles near `BANDWIDTH`, from two Riccati equations."""
    from scipy.linalg import solve_discrete_are

    n = len(plant.A)
    # Commands as the force's second derivative: then the weights are those of a chain of integrators.
    B, tiny = plant.B[:, None] / stiffness, 1e-12
    weight = np.array([[BANDWIDTH**-4]])
    cost = solve_discrete_are(plant.A, B, np.outer(plant.C, plant.C) + tiny * np.eye(n), weight)
    K = np.linalg.solve(weight + B.T @ cost @ B, B.T @ cost @ plant.A)[0] / stiffness

    A, C = _with_push(plant)
    noise = tiny * np.eye(n + 1)
    noise[n, n] = BANDWIDTH**6 * (T_s / stiffness) ** 2
    spread = solve_discrete_are(A.T, C[:, None], noise, np.eye(1))
    return Stabiliser(K, A @ spread @ C / (C @ spread @ C + 1.0))


def _with_push(plant: AxisPlant) -> tuple[np.ndarray, np.ndarray]:
    n = len(plant.A)
    A = np.block([[plant.A, plant.B[:, None]], [np.zeros((1, n)), np.eye(1)]])
    return A, np.append(plant.C, 0.0)


def signals(
    plant: AxisPlant, around: Stabiliser, pole: float, functions: int, theta: Float[np.ndarray, " angles"]
) -> tuple[Affine, Affine]:
    """Measured force [N] and acceleration asked [m/s²] of the closed loop, per heart [m], acceleration and noise.

    Args:
        plant: The world.
        around: Its `stabiliser`.
        pole: a of the Laguerre functions [-].
        functions: How many of them, besides the constant.
        theta: Angles θ = ω T_s [rad].
    """
    (n, m), (K, L) = (len(plant.A), len(plant.A) + 1), around
    A_push, C_push = _with_push(plant)
    B = plant.B[:, None]
    # States: the plant, and how far the observer is from it; there is no push, so that its estimate is all error.
    A = np.block([[plant.A - B * K, B * np.append(K, 1.0)], [np.zeros((m, n)), A_push - np.outer(L, C_push)]])
    missed = np.vstack([plant.E, np.zeros((1, 3))]) - np.outer(L, plant.D)
    E = np.vstack([plant.E, missed])
    Q_in = np.vstack([B, np.zeros((m, 1))])
    v = np.concatenate([-K, K, [1.0]])
    y, a = np.append(plant.C, np.zeros(m)), np.append(plant.C_a, np.zeros(m)) + v

    base = transfer(A, np.hstack([E, Q_in]), np.stack([y, a, np.append(np.zeros(n), C_push)]), theta)
    innovation = base[:, 2, :3] + plant.D
    from_Q = innovation[:, :, None] * laguerre(pole, functions, theta)[:, None, :]
    force = Affine(base[:, 0, :3] + plant.D, base[:, 0, 3, None, None] * from_Q)
    acceleration = Affine(base[:, 1, :3] + plant.D_a, (1.0 + base[:, 1, 3, None, None]) * from_Q)
    return force, acceleration


def laguerre(pole: float, functions: int, theta: Float[np.ndarray, " angles"]) -> Complex[np.ndarray, "angles weights"]:
    """The constant 1 and so many Laguerre functions at z = e^{jθ}; they are orthonormal over the circle."""
    z = np.exp(1j * theta)
    first = np.sqrt(1.0 - pole**2) / (z - pole)
    further = ((1.0 - pole * z) / (z - pole))[:, None] ** np.arange(functions)
    return np.hstack([np.ones((len(z), 1)), first[:, None] * further])


def law_of(plant: AxisPlant, around: Stabiliser, pole: float, weights: Float[np.ndarray, " weights"]) -> LinearLaw:
    """The law that a Q with these weights is: observer, push and Laguerre chain as states."""
    (n, functions), (K, L) = (len(plant.A), len(weights) - 1), around
    chain = np.zeros((functions, functions))
    into = np.zeros(functions)
    # Section k reads section k − 1 through (1 − a z)/(z − a) = −a + (1 − a²)/(z − a).
    for k in range(functions):
        chain[k, k] = pole
        chain[k, :k] = (1.0 - pole**2) * (-pole) ** np.arange(k - 1, -1, -1)
        into[k] = np.sqrt(1.0 - pole**2) * (-pole) ** k
    direct, tapped = weights[0], weights[1:]
    # Without the innovation's own observer x̂: everything is driven by e − C x̂.
    from_state = np.concatenate([plant.C, np.zeros(1 + functions)])
    A = np.zeros((n + 1 + functions,) * 2)
    A[:n, :n] = plant.A - np.outer(plant.B, K)
    A[:n, n + 1 :] = np.outer(plant.B, tapped)
    A[n, n] = 1.0
    A[n + 1 :, n + 1 :] = chain
    B = np.concatenate([L[:n] + direct * plant.B, L[n:], into])
    C = np.concatenate([-K, [-1.0], tapped])
    return LinearLaw(A - np.outer(B, from_state), B, C - direct * from_state, float(direct))
