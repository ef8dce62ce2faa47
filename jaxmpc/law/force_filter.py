"""Steady Kalman filter of one axis' measured force, whose model is a force with a slowly changing rate.

With ŷ⁻ = ŷₖ₋₁ + T_s r̂ₖ₋₁ and the innovation i = yₖ − ŷ⁻,   ŷₖ = ŷ⁻ + K_y i,   r̂ₖ = r̂ₖ₋₁ + K_r i
"""

from typing import Annotated, NamedTuple

from jaxmpc.law.scalar import Constant, Scalar


class ForceFilter(NamedTuple):
    """Constants; each may be a batch."""

    T_s: Annotated[Scalar, Constant(low=1e-5, below=0.2)]
    """Sampling time [s]."""
    force_gain: Annotated[Scalar, Constant(low=0.0, below=1.0)]
    """K_y [-]"""
    rate_gain: Annotated[Scalar, Constant(low=0.0, below=1e6)]
    """K_r [1/s]"""


class FilteredForce(NamedTuple):
    """What one axis' filter remembers between two samples."""

    force: Scalar
    """ŷ [N]"""
    rate: Scalar
    """r̂ [N/s]"""


def expected(constants: ForceFilter, state: FilteredForce) -> Scalar:
    """What is to be measured at the next sample [N]."""
    return state.force + constants.T_s * state.rate


def step(constants: ForceFilter, state: FilteredForce, measured: Scalar) -> FilteredForce:
    """Advance by one sample with a measured force [N]."""
    prior = expected(constants, state)
    innovation = measured - prior
    return FilteredForce(prior + constants.force_gain * innovation, state.rate + constants.rate_gain * innovation)
