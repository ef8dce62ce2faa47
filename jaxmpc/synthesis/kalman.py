"""Steady-state Kalman gain of the active observer."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.synthesis.linear import solve

Matrix = Float[Array, "n n"]
Vector = Float[Array, "n"]
Scalar = Float[Array, ""]

DOUBLINGS = 30
"""Steps of the doubling recursion: 2³⁰ samples, far beyond the slowest observer that makes sense."""


@jax.custom_jvp
def dare(Phi: Matrix, c: Vector, Q: Matrix, r: Scalar) -> Matrix:
    r"""Stabilising solution P of the filter Riccati equation, one measured output.

        P = Φ P Φᵀ − Φ P cᵀ (c P cᵀ + r)⁻¹ c P Φᵀ + Q

    Structured doubling with a fixed number of steps (Chu, Fan, Lin 2005): no data-dependent loop, so
    it batches and compiles once. The derivative comes from the equation itself, not from the
    iterations, as a linear rule that serves forward and reverse mode.

    Args:
        Phi: Transition matrix Φ.
        c: Output row c.
        Q: Process covariance Q.
        r: Measurement variance r.

    Returns:
        A-priori error covariance. Check `dare_residual` where (Φ, c) may not be detectable.
    """

    def double(carry: tuple[Matrix, Matrix, Matrix], _: None) -> tuple[tuple[Matrix, Matrix, Matrix], None]:
        A, G, H = carry
        W = jnp.eye(len(A)) + G @ H
        solved = solve(W, jnp.concatenate([A, G], axis=1))
        WA, WG = solved[:, : len(A)], solved[:, len(A) :]
        G_next = G + A @ WG @ A.T
        H_next = H + A.T @ H @ WA
        return (A @ WA, 0.5 * (G_next + G_next.T), 0.5 * (H_next + H_next.T)), None

    (_, _, P), _ = jax.lax.scan(double, (Phi.T, jnp.outer(c, c) / r, Q), length=DOUBLINGS)
    return P


@dare.defjvp
def _dare_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Matrix, Matrix]:
    r"""dP = Φc dP Φcᵀ + W with Φc = Φ − Φ K c, one linear solve of n² unknowns."""
    Phi, c, Q, r = primals
    dPhi, dc, dQ, dr = tangents
    P = dare(Phi, c, Q, r)
    K = P @ c / (c @ P @ c + r)
    Phi_c = Phi - jnp.outer(Phi @ K, c)
    half = (dPhi - jnp.outer(Phi @ K, dc)) @ P @ Phi_c.T
    W = half + half.T + dQ + dr * jnp.outer(Phi @ K, Phi @ K)
    n = len(P)
    dP = solve(jnp.eye(n * n) - jnp.kron(Phi_c, Phi_c), W.reshape(-1, 1)).reshape(n, n)
    return P, dP


def dare_residual(P: Matrix, Phi: Matrix, c: Vector, Q: Matrix, r: Scalar) -> Scalar:
    """How badly P misses the Riccati equation, relative to its largest entry [-]."""
    S = c @ P @ c + r
    miss = Phi @ P @ Phi.T - jnp.outer(Phi @ P @ c, Phi @ P @ c) / S + Q - P
    return jnp.max(jnp.abs(miss)) / jnp.max(jnp.abs(P))


def active_observer_gain(
    Phi: Float[Array, "2 2"],
    Gamma: Float[Array, "2"],
    Q_x: Scalar,
    Q_p: Scalar,
    R: Scalar,
    order: int = 1,
    delay: int = 1,
) -> tuple[Float[Array, " states"], Scalar]:
    r"""Kalman gain of the plant with its delayed inputs and an active state of order N, paper (11)–(14), (31)–(33).

    The covariances run on the *open-loop* augmented matrix Φₐ = [[Φᵣ, Γᵣ, 0], [0, J]], Cₐ = [C 0], where the Jordan
    block J of N ones adds to the active state and to each of its differences the next, and Q_p drives the last. Of two
    delayed inputs the first is the one that acts first, and becomes the second.

    Returns:
        K for force, force rate, delayed inputs, active state and its N − 1 differences, and the Riccati residual [-].
    """
    known = 2 + delay
    n = known + order
    chain = jnp.eye(n, k=1) + jnp.diag(jnp.where(jnp.arange(n) < known, 0.0, 1.0))
    Phi_a = chain.at[:2].set(jnp.block([Phi, Gamma[:, None], jnp.zeros((2, n - 3))]))
    zero = 0.0 * Q_p
    Q = jnp.diag(jnp.stack([*[Q_x] * known, *[zero] * (order - 1), Q_p]))
    return _gain(Phi_a, jnp.eye(n)[0] + zero, Q, R)


def input_noise_gain(
    Phi: Float[Array, "2 2"], Gamma: Float[Array, "2"], Q_x: Scalar, Q_p: Scalar, R: Scalar, delay: int = 1
) -> tuple[Float[Array, " states"], Scalar]:
    r"""Kalman gain of the classical estimate: white acceleration noise Q_p on the contact, no active state.

    Delayed inputs are known, so their gains, like that of the missing active state, are zero.
    """
    zero, one = 0.0 * Q_p, 1.0 + 0.0 * Q_p
    K, residual = _gain(Phi, jnp.stack([one, zero]), Q_p * jnp.outer(Gamma, Gamma) + Q_x * jnp.eye(2), R)
    return jnp.concatenate([K, jnp.stack([zero] * (delay + 1))]), residual


def _gain(Phi: Matrix, c: Vector, Q: Matrix, R: Scalar) -> tuple[Vector, Scalar]:
    P = dare(Phi, c, Q, R)
    return P @ c / (c @ P @ c + R), dare_residual(P, Phi, c, Q, R)
