"""Design of the Kalman filter on the measured force: its steady gains, in closed form.

With κ = (ω₀ T_s)² the poles p of the predictor and 1/p solve p + 1/p = 2 ± iκ, so that

    σ = κ/2 + √(κ²/4 + 4),  |p| = 2/(σ + √(κ σ)),  K_y = 1 − |p|²,  K_r = κ |p|/T_s

which is the Riccati equation's answer to a rate that changes by ω₀² T_s per sample, over the measured force's noise.
"""

import math

from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar

LEAST_NOISE = 1e-6
"""Noise of a sensor that has none, for which no steady filter filters [N]."""
QUICKEST = 1e3
"""Largest ω₀ T_s [rad]: a filter as quick as that lets all but a part in 1e12 pass. From 1.2e4 on it would be all to
the last bit, and K_y = 1 is no filter of the law."""


def force_filter(cutoff: Scalar | None, T_s: Scalar, ops: Ops) -> ForceFilter | None:
    """Steady Kalman filter of a force with a slowly changing rate; None for none.

    Args:
        cutoff: Natural frequency ω₀ of its poles, which are damped by 1/√2 where ω₀ T_s is small [rad/s].
        T_s: Sampling time [s].
        ops: Scalar functions.
    """
    if cutoff is None:
        return None
    kappa = cutoff * T_s * cutoff * T_s
    sigma = 0.5 * kappa + ops.sqrt(0.25 * kappa * kappa + 4.0)
    radius = 2.0 / (sigma + ops.sqrt(kappa * sigma))
    return ForceFilter(T_s, 1.0 - radius * radius, kappa * radius / T_s)


def cutoff_of(rate_change: float, noise: float, T_s: float) -> float | None:
    """Natural frequency of the filter that an experiment's sensor asks for [rad/s]; None for a change of 0.

    It is no higher than `QUICKEST` allows.

    Args:
        rate_change: Standard deviation of the rate's change per sample [N/s].
        noise: Standard deviation of the measured force [N].
        T_s: Sampling time [s].
    """
    if not rate_change:
        return None
    return min(math.sqrt(rate_change / (max(noise, LEAST_NOISE) * T_s)), QUICKEST / T_s)
