"""Fit of friction, presliding and mass scale to the smoothed motion of the arm.

q, q̇ and q̈ come from one smoothing spline with continuous acceleration and no lag; the bristle follows its path.
Torques and all they are explained by then pass the same low-pass, forward and backward: what noise and smoothing do
to fast motion is out of the fit, and nothing is out of step.

For a given presliding z all else is linear least squares, and log z is searched joint by joint. Then all parameters
are polished together, each joint weighted by its residual, since they share the mass scale. Standard errors allow for
residuals that differ in size and are correlated for a quarter of a second: block sandwich H⁻¹ (Σ g gᵀ) H⁻¹ with the
gradient g of each block. They say nothing of a model that is wrong.
"""

from collections.abc import Sequence
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from jaxmpc.world.friction import SMALL_VELOCITY

PRESLIDING_BOUNDS = (2e-5, 2e-2)
"""Where z is searched [rad]; a motor encoder of 4096 counts resolves 4e-5 to 9e-5 rad at the joints."""
BLOCK = 0.25
"""Time within which residuals may be correlated [s]."""


class Band:
    """Low-pass without lag from n samples of a recording to the m that are fitted."""

    def __init__(self, rate: float, cutoff: float, used: slice) -> None:
        from scipy.signal import butter

        self.used, self.every = used, max(int(rate / (8.0 * cutoff)), 1)
        self.filter = butter(4, cutoff, fs=rate, output="sos")

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values of the samples that are fitted, time first."""
        from scipy.signal import sosfiltfilt

        kept: np.ndarray = sosfiltfilt(self.filter, values, axis=0)[self.used]
        return kept[:: self.every]


class JointData(NamedTuple):
    """One joint."""

    slid: np.ndarray
    """Smoothed motion from sample to sample, shape (n − 1,) [rad]."""
    dt: np.ndarray
    """Time from sample to sample, shape (n − 1,) [s]."""
    band: Band
    qdot: np.ndarray
    """Velocity, shape (m,) [rad/s]."""
    links: np.ndarray
    """Torque of the model's links, shape (m,) [N m]."""
    torque: np.ndarray
    """Measured torque less the drives' inertia, shape (m,) [N m]."""


class Fit(NamedTuple):
    """Parameters per joint are D [N m s/rad], F_c [N m], log z [-] and, where wanted, τ₀ [N m]."""

    per_joint: np.ndarray
    """Shape (4, 3 or 4)."""
    per_joint_error: np.ndarray
    """Standard errors, the same shape."""
    mass_scale: float
    mass_scale_error: float
    friction: np.ndarray
    """Torque D q̇ + F_c s, shape (m, 4) [N m]."""
    residual: np.ndarray
    """Shape (m, 4) [N m]."""


def smooth(t: np.ndarray, q: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed q and its two derivatives; amplitude 1 / (1 + (f / cutoff)⁴)."""
    from scipy.interpolate import make_smoothing_spline

    # In samples, not seconds: the spline's equations are badly conditioned otherwise.
    dt = float(np.median(np.diff(t)))
    spline = make_smoothing_spline((t - t[0]) / dt, q, lam=(2.0 * np.pi * cutoff * dt) ** -4)
    position, velocity, qddot = (spline.derivative(n) if n else spline for n in range(3))
    at = (t - t[0]) / dt
    return position(at), velocity(at) / dt, qddot(at) / dt**2


def rigid_body(q: np.ndarray, qdot: np.ndarray, qddot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M_L(q) q̈ + c(q, q̇) of the links, gravity included, shape (n, 4) [N m], and the drives' inertia A [kg m²]."""
    import mujoco

    model = mujoco.MjModel.from_xml_string((files("jaxmpc") / "world" / "wam.xml").read_text(encoding="utf-8"))
    data = mujoco.MjData(model)
    torque, result = np.empty_like(q), np.zeros(model.nv)
    for k in range(len(q)):
        data.qpos[:4], data.qvel[:4], data.qacc[:4] = q[k], qdot[k], qddot[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        # Newton-Euler knows links only: armature and joint damping are no part of it.
        mujoco.mj_rne(model, data, 1, result)
        torque[k] = result[:4]
    return torque, np.array(model.dof_armature[:4])


def bristle(joint: JointData, log_z: float) -> tuple[np.ndarray, np.ndarray]:
    """Deflection s and ∂s/∂log z, shape (m,), along the path from s = 0.

    Exact at constant velocity v between samples: s⁺ = s* + (s − s*) exp(−h |v|_ε / z), s* = v / |v|_ε.
    """
    from scipy.linalg import solve_banded

    length = np.hypot(joint.slid, SMALL_VELOCITY * joint.dt)
    target, exponent = joint.slid / length, length / np.exp(log_z)
    kept = np.exp(-exponent)
    # The recurrence as a bidiagonal system: sₖ₊₁ − e sₖ = (1 − e) s*.
    bands = np.ones((2, len(kept) + 1))
    bands[1, :-1] = -kept
    s = solve_banded((1, 0), bands, np.append(0.0, (1.0 - kept) * target))
    slope = solve_banded((1, 0), bands, np.append(0.0, kept * exponent * (s[:-1] - target)))
    return joint.band(s), joint.band(slope)


def _linear(joint: JointData, log_z: float, offsets: bool) -> tuple[np.ndarray, float]:
    """Best μ, D, F_c and τ₀ at a presliding, and the mean square left over [N² m²]."""
    columns = [joint.links, joint.qdot, bristle(joint, log_z)[0]]
    design = np.column_stack(columns + [np.ones_like(columns[0])] * offsets)
    best = np.linalg.lstsq(design, joint.torque)[0]
    return best, float(np.mean((joint.torque - design @ best) ** 2))


def _search(joint: JointData, offsets: bool) -> tuple[np.ndarray, float]:
    """First guess D, F_c, log z and τ₀ of one joint with a mass scale of its own, and the mean square left over."""
    from scipy.optimize import minimize_scalar

    # A coarse look first: far from the true z the misfit is flat, and a local search would stay there.
    low, high = np.log(PRESLIDING_BOUNDS)
    grid = np.linspace(low, high, 9)
    best = int(np.argmin([_linear(joint, log_z, offsets)[1] for log_z in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    log_z = float(minimize_scalar(lambda x: _linear(joint, x, offsets)[1], bounds=bounds, options={"xatol": 1e-2}).x)
    (_, D, F_c, *tau_0), left = _linear(joint, log_z, offsets)
    return np.array([D, F_c, log_z, *tau_0]), left


def fit(joints: Sequence[JointData], t: np.ndarray, offsets: bool) -> Fit:
    """Weighted nonlinear least squares over all joints.

    Args:
        joints: Four.
        t: Times of the samples that are fitted, shape (m,) [s].
        offsets: Whether τ₀ is estimated.
    """
    from scipy.optimize import least_squares

    guesses = [_search(joint, offsets) for joint in joints]
    weight = np.array([1.0 / np.sqrt(left) for _, left in guesses])
    start = np.stack([guess for guess, _ in guesses])
    low, high = np.full_like(start, -np.inf), np.full_like(start, np.inf)
    low[:, :2] = 0.0
    low[:, 2], high[:, 2] = np.log(PRESLIDING_BOUNDS)
    start = np.clip(start, low, high)
    size, m = start.shape[1], len(t)

    def model(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Friction and residual, shape (m, 4), and the residual's slopes, shape (m, 4, 1 + 4 size)."""
        friction, residual, slopes = np.empty((m, 4)), np.empty((m, 4)), np.zeros((m, 4, len(x)))
        for j, joint in enumerate(joints):
            own = slice(1 + j * size, 1 + (j + 1) * size)
            D, F_c, log_z, *tau_0 = x[own]
            s, s_slope = bristle(joint, log_z)
            friction[:, j] = D * joint.qdot + F_c * s
            residual[:, j] = joint.torque - x[0] * joint.links - friction[:, j] - sum(tau_0)
            slopes[:, j, 0] = -joint.links
            slopes[:, j, own] = -np.column_stack([joint.qdot, s, F_c * s_slope] + [np.ones(m)] * offsets)
        return friction, residual, slopes

    def weighted_residual(x: np.ndarray) -> np.ndarray:
        return np.ravel(weight * model(x)[1])

    def weighted_slopes(x: np.ndarray) -> np.ndarray:
        return np.reshape(weight[:, None] * model(x)[2], (4 * m, len(x)))

    best = least_squares(
        weighted_residual,
        np.concatenate([[1.0], start.ravel()]),
        jac=weighted_slopes,
        bounds=(np.concatenate([[-np.inf], low.ravel()]), np.concatenate([[np.inf], high.ravel()])),
        x_scale="jac",
    ).x
    friction, residual, slopes = model(best)
    error = _standard_errors(weight * residual, weight[:, None] * slopes, t)
    return Fit(
        best[1:].reshape(4, size), error[1:].reshape(4, size), float(best[0]), float(error[0]), friction, residual
    )


def _standard_errors(residual: np.ndarray, slopes: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Block sandwich; residual (m, 4), slopes (m, 4, p), times (m,) [s]."""
    p = slopes.shape[2]
    gradient = np.einsum("mj,mjp->mp", residual, slopes)
    first = np.flatnonzero(np.diff(np.floor((t - t[0]) / BLOCK), prepend=-1.0))
    blocks = np.add.reduceat(gradient, first, axis=0)
    inverse = np.linalg.pinv(np.einsum("mjp,mjq->pq", slopes, slopes))
    # As many parameters as blocks would fit each block's gradient to zero.
    spare = len(blocks) / max(len(blocks) - p, 1)
    # Of what moves nothing, as the presliding of a joint without friction, it is 0 but for rounding.
    error: np.ndarray = np.sqrt(np.maximum(spare * np.diagonal(inverse @ blocks.T @ blocks @ inverse), 0.0))
    return error
