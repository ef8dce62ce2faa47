"""Frequency response of the loop, in closed form.

The law's equations are triangular in the z-domain, so its transfer function needs no matrix at all. A
test holds these formulas against the matrices that the running law itself gives.
"""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from jaxmpc.law.cascade import Gains
from jaxmpc.world.contact import Contact

Response = Complex[Array, "..."]
Break = Literal["v", "a"]


def controller_response(gains: Gains, q: Response) -> Response:
    r"""V/Y of the cascade at q = z⁻¹ [m/s²/N].

    Every signal is written s_I·I + s_V·V in the innovation I and the command V, from the observer's
    last state to its first; V and Y then give two equations.
    """
    (phi_12, phi_22), (gamma_1, gamma_2) = gains.phi, gains.gamma
    K_1, K_2, K_3, K_p = (gains.K[i] for i in range(4))
    p = K_p / (1.0 - q)
    x3_I, x3_V = q * p + K_3, q
    x2_I = (gamma_2 * q * x3_I + K_2) / (1.0 - phi_22 * q)
    x2_V = gamma_2 * q * x3_V / (1.0 - phi_22 * q)
    x1_I = (q * (phi_12 * x2_I + gamma_1 * x3_I) + K_1) / (1.0 - q)
    x1_V = q * (phi_12 * x2_V + gamma_1 * x3_V) / (1.0 - q)
    y_I, y_V = x1_I - K_1 + 1.0, x1_V

    integrate = gains.input_gain / (1.0 - (1.0 - gains.mpc_u) * q)
    weight_1 = gains.L[0] + integrate * gains.mpc_x[0]
    weight_2 = gains.L[1] + integrate * gains.mpc_x[1]
    v_I = -(weight_1 * x1_I + weight_2 * x2_I + gains.L[2] * x3_I + p)
    v_V = -(weight_1 * x1_V + weight_2 * x2_V + gains.L[2] * x3_V)
    return v_I / ((1.0 - v_V) * y_I + v_I * y_V)


def tip_response(contact: Contact, q: Response, late: Float[Array, ""], T_s: float) -> tuple[Response, Response]:
    r"""Tip position [s²] and velocity [s] per acceleration asked of the robot, at q = z⁻¹.

    Args:
        contact: The world.
        q: z⁻¹.
        late: Additional delay of the held command, any number of samples ≥ 0; a fraction f splits each
            hold in two: the older command for f T_s, the newer for the rest.
        T_s: Sampling time [s].
    """
    whole = jnp.floor(late)
    (first, second), (first_new, second_new) = contact.gamma[::-1], _held(contact, 1.0 - (late - whole), T_s)
    delay = q ** (1.0 + contact.extra_delay + whole)
    gamma_1 = (second_new + q * (second - second_new)) * delay
    # What the older command leaves behind is carried on by the rest of the sample.
    gamma_2 = (first_new + q * (first - first_new)) * delay
    xdot = gamma_2 * q / (1.0 - contact.phi[1] * q)
    x = q * (contact.phi[0] * xdot + gamma_1) / (1.0 - q)
    return x, xdot


def _held(contact: Contact, part: Float[Array, ""], T_s: float) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """First and second hold integral over the last part of a sample."""
    from jaxmpc.synthesis.plant import hold_integrals

    damping = (1.0 - contact.phi[1]) / contact.phi[0]
    return hold_integrals(damping, part * T_s)


def loop_response(
    gains: Gains, contact: Contact, omega: Float[Array, "..."], T_s: float, at: Break, late: Float[Array, ""] | float = 0.0
) -> Response:
    r"""Open-loop L(e^{jωT_s}) of the negative feedback 1 + L, broken at v or at a = v − K₂ẋ [-].

    Args:
        gains: One controller.
        contact: One world.
        omega: Angular frequencies [rad/s].
        T_s: Sampling time [s].
        at: The signal at which the loop is cut, and at which `late` acts.
        late: Delay added there [samples].
    """
    q = jnp.exp(-1j * omega * T_s)
    late = jnp.asarray(late)
    x, xdot = tip_response(contact, q, late, T_s)
    sensor = (1.0 - contact.sensor_pole) / (1.0 - contact.sensor_pole * q)
    velocity = (1.0 - contact.velocity_pole) / (1.0 - contact.velocity_pole * q)
    force_loop = -controller_response(gains, q) * sensor * contact.stiffness * x
    if at == "a":
        return force_loop + contact.K2 * velocity * xdot
    _, xdot_now = tip_response(contact, q, jnp.zeros_like(late), T_s)
    return force_loop / (1.0 + contact.K2 * velocity * xdot_now)
