r"""A PI force controller with damping, as gains of the same cascade: so engine, margins and arm are the same.

    vₖ = K_p (uₖ − yₖ),   uₖ = uₖ₋₁ + (T_s/T_i) (F_d − yₖ),   aₖ = vₖ − K₂ẋ

is the law of `jaxmpc.law.cascade` with K = (1, 0, 0, 0), φ = γ = 0, which make x̂₁ = y, p̂ = 0 and x̂₂ of no account,
L = (K_p, 0, 0), g = K_p, r = mₓ₁ = T_s/T_i and mₓ₂ = mᵤ = 0. Seen from the force it is a PI controller,

    V/Y = −K_p (1 + (T_s/T_i)/(1 − z⁻¹)),

whose reference acts through the integral alone, so that a step of it gives no kick.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.experiment import Experiment
from jaxmpc.law.gains import Gains
from jaxmpc.quantities import HP_MAX
from tuning.job.space import FreeParameter


class Pi(NamedTuple):
    """Parameters of the controller."""

    K_p: Any
    """Acceleration per force [m/s²/N]."""
    T_i: Any
    """Integral time [s]."""
    K2: Any
    """Damping of the tip velocity [1/s]."""


AXES = (
    FreeParameter("K_p", 1e-2, 1e2, 1.0, 0),
    FreeParameter("T_i", 1e-3, 1e1, 1.0, 0),
    FreeParameter("K2", 1.0, 300.0, 1.0, 0),
)
"""The room in which it is tuned."""


def gains(pi: Pi, T_s: Any) -> Gains:
    """Gains of the law; traceable."""
    K_p, zero, one = jnp.asarray(pi.K_p, jnp.float64), jnp.zeros(()), jnp.ones(())
    share = T_s / pi.T_i
    return Gains(
        phi=jnp.zeros(2),
        gamma=jnp.zeros(2),
        K=jnp.stack([one, zero, zero, zero]),
        L=jnp.stack([K_p, zero, zero]),
        input_gain=K_p,
        mpc_ref=jnp.zeros(HP_MAX).at[0].set(share),
        mpc_x=jnp.stack([share, zero]),
        mpc_u=zero,
    )


def textbook(experiment: Experiment) -> Pi:
    """The SIMC rules at the stiffest tissue, once for the damping and once for the force around it.

    Of an integrating process k′ e^{−θs}/s they make K_c = 1/(k′ (τ_c + θ)) and T_i = 4 (τ_c + θ), with τ_c = θ for a
    tight but robust loop; half of a small lag counts as delay (the half rule). The damping sees k′ = 1 and the lag of
    its velocity filter, the force k′ = K_s/K₂ and the lag 1/K₂; the delay is the command's and half a sample.

    S. Skogestad, "Simple analytic rules for model reduction and PID controller tuning", J. Process Control 13 (2003).
    """
    delay = (experiment.delay + 0.5) * experiment.sampling_time
    K2 = 0.5 / (delay + 0.5 / experiment.velocity_lowpass)
    theta = delay + 0.5 / K2
    return Pi(K2 / max(experiment.stiffness) / (2.0 * theta), 8.0 * theta, K2)


def decode(z: Float[Array, "3"]) -> Pi:
    """Parameters of one unconstrained vector; traceable."""
    return Pi(*(axis.value(z[i]) for i, axis in enumerate(AXES)))


def encode(controller: Pi) -> Float[np.ndarray, "3"]:
    """The inverse of `decode`, inside of the room."""
    return np.array([axis.unconstrained(value) for axis, value in zip(AXES, controller, strict=True)])
