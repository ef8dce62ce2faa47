"""The peers of the sweep engine: what one would write without it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.signal

from jaxmpc.engine.base import ScenarioData
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains
from jaxmpc.world import contact as world
from jaxmpc.world.contact import Contact


def numpy_loop(gains: Gains, contacts: Contact, scene: ScenarioData, dtype: Any) -> np.ndarray:
    """A Python loop over time on preallocated arrays, vectorised over controllers × stiffnesses × axes.

    Every operation of the closed loop writes into an array that exists; noise, quantiser and metrics are
    in it, as in the engine.

    Args:
        gains: One value per controller, taken apart into scalars, for a constant reference.
        contacts: One value per controller and stiffness.
        scene: The experiment.
        dtype: Of the arrays.

    Returns:
        Metrics in the order of `Metrics`, shape (11, stiffness, axis, controller): without how the force swings,
        which is last and which nobody asks here. The linear loop has no joints.
    """
    shape = (len(np.asarray(scene.stiffness)), 3, len(np.asarray(gains.mpc_u)))

    def controller(x: Any) -> np.ndarray:
        return np.ascontiguousarray(np.broadcast_to(np.asarray(x, dtype), shape))

    def tissue(x: Any) -> np.ndarray:
        wide = np.asarray(x, dtype).T[:, None, :] if np.ndim(x) == 2 else np.asarray(x, dtype)
        return np.ascontiguousarray(np.broadcast_to(wide, shape))

    phi_12, phi_22, gamma_1, gamma_2 = map(controller, (*gains.phi, *gains.gamma))
    K_1, K_2, K_3, K_p = map(controller, gains.K)
    L_1, L_2, L_3 = map(controller, gains.L)
    g, k_F, m_1, m_2, keep = map(
        controller, (gains.input_gain, gains.mpc_ref[0], *gains.mpc_x, 1.0 - np.asarray(gains.mpc_u))
    )
    K_s, tip_12, tip_22, tip_1, tip_2 = map(tissue, (contacts.stiffness, *contacts.phi, *contacts.gamma))
    signals = [
        np.asarray(s, dtype) for s in (scene.signals.heart, scene.signals.noise, scene.signals.force_ref[:, :, 0])
    ]
    score, lsb = np.asarray(scene.signals.score), np.asarray(scene.lsb, dtype)[None, :, None]

    y_hat, r_hat, d_hat, p, u, v, x, xdot, one, two, e = (np.zeros(shape, dtype) for _ in range(11))
    squares, true_squares, effort, chatter, peak, v_before, true = (np.zeros(shape, dtype) for _ in range(7))
    scored = np.asarray(scene.signals.score, dtype)
    highest, true_highest = (np.full(shape, -np.inf, dtype) for _ in range(2))
    lowest, true_lowest = (np.full(shape, np.inf, dtype) for _ in range(2))
    for k in range(score.shape[1]):
        heart, noise, ref = (s[:, k][None, :, None] for s in signals)
        np.subtract(x, heart, out=one)
        one *= K_s
        np.subtract(one, ref, out=true)
        one += noise
        one /= lsb
        one += 0.5
        np.floor(one, out=one)
        one *= lsb
        force = one
        # prediction: y⁻ = ŷ + φ₁₂ r̂ + γ₁ d̂, r⁻ = φ₂₂ r̂ + γ₂ d̂, d⁻ = v + p̂
        np.multiply(phi_12, r_hat, out=two)
        y_hat += two
        np.multiply(gamma_1, d_hat, out=two)
        y_hat += two
        r_hat *= phi_22
        np.multiply(gamma_2, d_hat, out=two)
        r_hat += two
        np.add(v, p, out=d_hat)
        np.subtract(force, y_hat, out=e)
        for gain, estimate in ((K_1, y_hat), (K_2, r_hat), (K_3, d_hat), (K_p, p)):
            np.multiply(gain, e, out=two)
            estimate += two
        u *= keep
        np.multiply(m_1, y_hat, out=two)
        u -= two
        np.multiply(m_2, r_hat, out=two)
        u -= two
        np.multiply(k_F, ref, out=two)
        u += two
        # The plant takes the command of the sample before; then the new one is formed.
        np.multiply(tip_12, xdot, out=two)
        x += two
        np.multiply(tip_1, v, out=two)
        x += two
        xdot *= tip_22
        np.multiply(tip_2, v, out=two)
        xdot += two
        np.multiply(g, u, out=v)
        for weight, estimate in ((L_1, y_hat), (L_2, r_hat), (L_3, d_hat)):
            np.multiply(weight, estimate, out=two)
            v -= two
        v -= p
        counts = scored[:, k][None, :, None]
        np.abs(force, out=two)
        np.maximum(peak, two, out=peak)
        force -= ref
        for high, low, value in ((highest, lowest, force), (true_highest, true_lowest, true)):
            np.maximum(high, value, out=high, where=counts > 0.0)
            np.minimum(low, value, out=low, where=counts > 0.0)
        for total, value in ((squares, force), (true_squares, true), (effort, v)):
            np.multiply(value, value, out=two)
            two *= counts
            total += two
        np.subtract(v, v_before, out=two)
        two *= two
        two *= counts
        chatter += two
        v_before[:] = v
    samples = np.maximum(score[0].sum(), 1)
    rms, true_rms, asked, change = (np.sqrt(total / samples) for total in (squares, true_squares, effort, chatter))
    largest = np.maximum(highest, -lowest)
    none, spans = np.zeros_like(rms), (highest - lowest, true_highest - true_lowest)
    joints = none, none, none
    return np.stack([rms, spans[0], true_rms, spans[1], asked, change, peak, largest, *joints])


def loop_system(gains: Gains, contact: Contact) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State-space matrices of one closed loop from heart, noise and reference to the measured force."""
    size = 13

    def step(state: Sequence[float], heart: float, noise: float, ref: float) -> tuple[list[float], float]:
        x_hat, (p, u, v, *tip, newest, older) = tuple(state[:3]), state[3:]
        plant = world.ContactState(*tip, (newest, older))
        measured, plant = world.sense(contact, plant, heart)
        measured = measured + noise
        controller, v = cascade.step(gains, cascade.AxisState(x_hat, p, u, v), measured, (ref,))
        plant, _ = world.move(contact, plant, v)
        flat = [*controller.x_hat, controller.p_hat, controller.u, controller.v, *plant[:-1], *plant.pending]
        return flat, measured

    columns = [step(row, 0.0, 0.0, 0.0) for row in np.eye(size)]
    inputs = [step([0.0] * size, *row) for row in np.eye(3)]
    A, C = np.column_stack([c[0] for c in columns]), np.array([[c[1] for c in columns]])
    B, D = np.column_stack([c[0] for c in inputs]), np.array([[c[1] for c in inputs]])
    return A, B, C, D


def dlsim_residual(gains: Gains, contact: Contact, scene: ScenarioData, axis: int) -> float:
    """Residual RMS of one controller on one tissue and axis by scipy; it knows no quantiser [N]."""
    signals = scene.signals
    ref = np.asarray(signals.force_ref)[axis, :, 0]
    inputs = np.column_stack([np.asarray(signals.heart)[axis], np.asarray(signals.noise)[axis], ref])
    _, force, _ = scipy.signal.dlsim((*loop_system(gains, contact), float(scene.path.T_s)), inputs)
    error = (force[:, 0] - ref)[np.asarray(signals.score)[axis]]
    return float(np.sqrt(np.mean(error**2)))
