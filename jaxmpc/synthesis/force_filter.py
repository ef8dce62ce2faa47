"""Design of the Kalman filter on the measured force: its steady gains."""

import numpy as np

from jaxmpc.law.force_filter import ForceFilter


def force_filter(rate_change: float, noise: float, T_s: float) -> ForceFilter | None:
    """Steady Kalman filter of a force with a slowly changing rate; None for a change of 0.

    Args:
        rate_change: Standard deviation of the rate's change per sample [N/s].
        noise: Standard deviation of the measured force [N].
        T_s: Sampling time [s].
    """
    from scipy.linalg import solve_discrete_are

    if not rate_change:
        return None
    A, C = np.array([[1.0, T_s], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    R = max(noise, 1e-6) ** 2
    P = solve_discrete_are(A.T, C.T, np.diag([0.0, rate_change**2]), np.array([[R]]))
    force_gain, rate_gain = (P @ C.T / (C @ P @ C.T + R)).ravel().tolist()
    return ForceFilter(T_s, force_gain, rate_gain)
