"""An independent model of the closed loop: numpy, matrices, matrix exponentials; nothing of the package."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.linalg

T_S = 1e-3
HISTORY = 24


@cache  # asked for every state of every loop, of which it takes most of the time
def _hold(damping: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    block = np.zeros((3, 3))
    block[:2] = [[0.0, 1.0, 0.0], [0.0, -damping, 1.0]]
    full = scipy.linalg.expm(block * seconds)
    return full[:2, :2], full[:2, 2]


def loop_matrices(
    gains: Any,
    K_s: float,
    K2: float,
    delay: int = 1,
    ideal: bool = True,
    sensor_cutoff: float = 0.0,
    velocity_cutoff: float = 180.0,
    gain_v: float = 1.0,
    gain_a: float = 1.0,
    late_v: float = 0.0,
    late_a: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State-space matrices of the closed loop: inputs heart [m], noise [N], reference [N]; output measured force.

    `gain_*` scale and `late_*` [samples, any fraction] delay the signal at v or at a. Commands wait in
    explicit queues; a fraction of a sample splits the hold, by matrix exponentials.
    """
    Phi_plant, Gamma_full = _hold(K2 if ideal else 0.0, T_S)
    alpha = np.exp(-sensor_cutoff * T_S) if sensor_cutoff else 0.0
    beta = np.exp(-velocity_cutoff * T_S)
    K, L = np.asarray(gains.K, float), np.asarray(gains.L, float)
    order = len(K) - 3
    # Of two inputs on the way the earlier comes first: it acts, and the later takes its place.
    waiting = 1 if gains.K_earlier is None else 2
    known = 2 + waiting
    Phi_r = np.eye(known, k=1)
    Phi_r[:2] = 0.0
    Phi_r[:2, :2] = [[1.0, gains.phi[0]], [0.0, gains.phi[1]]]
    Phi_r[:2, 2] = gains.gamma
    if waiting == 2:
        K = np.insert(K, 2, float(gains.K_earlier))
    ahead = np.linalg.matrix_power(Phi_r, waiting - 1)
    k_ref = float(np.sum(gains.mpc_ref))

    def push(queue: np.ndarray, value: float, late: float) -> tuple[np.ndarray, np.ndarray]:
        queue = np.concatenate([[value], queue[:-1]])
        whole = int(np.floor(late))
        part = late - whole
        _, newer = _hold(K2 if ideal else 0.0, T_S * (1.0 - part))
        at = delay + whole
        return queue, newer * queue[at] + (Gamma_full - newer) * queue[at + 1]

    differences = np.eye(order) + np.eye(order, k=1)

    def step(state: np.ndarray, heart: float, noise: float, ref: float) -> tuple[np.ndarray, float]:
        x_hat, p, (u, v_last), state = np.split(state, np.cumsum([known, order, 2]))
        tip, x_before, force_f, velocity_f = state[:2], state[2], state[3], state[4]
        queue_v, queue_w = state[5 : 5 + HISTORY], state[5 + HISTORY :]
        force_f = alpha * force_f + (1.0 - alpha) * K_s * (tip[0] - heart)
        velocity_f = beta * velocity_f + (1.0 - beta) * (tip[0] - x_before) / T_S
        y = force_f + noise
        prior = Phi_r @ x_hat + (v_last + p[0]) * np.eye(known)[-1]
        innovation = y - prior[0]
        x_hat, p = prior + K[:known] * innovation, differences @ p + K[known:] * innovation
        expected = (ahead @ x_hat)[:3]
        u = u + k_ref * ref - np.asarray(gains.mpc_x) @ expected[:2] - gains.mpc_u * u
        v = gains.input_gain * u - L @ expected - p[0]
        damping = 0.0 if ideal else -K2 * velocity_f
        queue_v, push_v = push(queue_v, gain_v * gain_a * v, late_v + late_a)
        queue_w, push_w = push(queue_w, gain_a * damping, late_a)
        x_before, tip = tip[0], Phi_plant @ tip + push_v + push_w
        return np.concatenate([x_hat, p, [u, v], tip, [x_before, force_f, velocity_f], queue_v, queue_w]), y

    size = 7 + known + order + 2 * HISTORY
    zero = np.zeros(size)
    columns = [step(row, 0.0, 0.0, 0.0) for row in np.eye(size)]
    inputs = [step(zero, *row) for row in np.eye(3)]
    A, C = np.column_stack([c[0] for c in columns]), np.array([[c[1] for c in columns]])
    B, D = np.column_stack([c[0] for c in inputs]), np.array([[c[1] for c in inputs]])
    return A, B, C, D


@pytest.fixture(scope="session")
def independent_loop() -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """`loop_matrices` above."""
    return loop_matrices
