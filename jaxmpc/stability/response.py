"""Frequency response of the loop, in closed form.

The law's equations are triangular in the z-domain, so its transfer function needs no matrix at all. A
test holds these formulas against an independent state-space model of the whole loop, as others hold the law.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Complex

from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gains import Gains
from jaxmpc.stability import held_beat
from jaxmpc.stability.held_beat import HeldBeat
from jaxmpc.synthesis.plant import hold_integrals
from jaxmpc.world.contact import Contact

Response = Complex[Array, "..."]


def controller_response(gains: Gains, q: Response, held: HeldBeat | None = None) -> Response:
    r"""V/Y of the cascade at q = z⁻¹ [m/s²/N], without a division before the last but one.

    Every signal is a combination of the innovation I and the command V. With the disturbance order N, d = 1 − q,
    e = 1 − φ₂₂ q, m = 1 − (1 − mᵤ) q the law's equations, from the observer's last state to its first, read

        dᴺ P̂ = n_p I,  dᴺ X̂₃ = n₃ I + q dᴺ V,  e dᴺ X̂₂ = n₂ I + γ₂ q² dᴺ V,  e dᴺ⁺¹ X̂₁ = n₁ I + q² dᴺ b V,

    Y = X̂₁ + (1 − K₁) I, and V = −(L₁ + g m₁/m) X̂₁ − (L₂ + g m₂/m) X̂₂ − L₃ X̂₃ − P̂. Without I, and
    with wᵢ = m Lᵢ + g mᵢ and f_I I + f_V V what the law makes of both,

        V/Y = f_I / (dᴺ {q² w₂ (γ₁ K₂ − γ₂ K₁) − m [q b K₃ + (1 + q L₃)(q φ₁₂ K₂ + e K₁)] − (1 − K₁)(m e d + f_V)}),

    after e dᴺ⁺¹ has cancelled out: so the N integrators keep their digits down to any frequency.

    Where commands act after two samples, Ŵ acts where X̂₃ does above, and X̃ = (X̂ − K I)/q is in the place of X̂ in V:

        dᴺ Ŵ = n_w I + q² dᴺ V,  n_w = q n₃ + K_w dᴺ,
        e dᴺ X̃₂ = (γ₂ n_w + K₂ φ₂₂ dᴺ) I + γ₂ q² dᴺ V,  e dᴺ⁺¹ X̃₁ = (b n_w + (φ₁₂ K₂ + e K₁) dᴺ) I + q² dᴺ b V,
        V/Y = f_I / (dᴺ {q² [w₂ (K₂ (γ₁ − b) − γ₂ K₁) − w₁ b K₁] − (1 − K₁)(m e d + f_V)
                         − m [q² b K₃ + (1 + q L₃)(q b K_w + q φ₁₂ K₂ + e K₁)]}).

    Where beats are learned (`held_beat`), −R Y is added to the wanted force, and ρ = Σ rᵢ times g to m V. In place of
    f_I then stands f_I + g ρ R Y_I, with Y_I = n₁ + (1 − K₁) e dᴺ⁺¹, or q n₁ + e dᴺ⁺¹ where commands act later.
    """
    (phi_12, phi_22), (gamma_1, gamma_2) = gains.phi, gains.gamma
    K_1, K_2, K_3, *K_p = (gains.K[i] for i in range(len(gains.K)))
    d, e, m = 1.0 - q, 1.0 - phi_22 * q, 1.0 - (1.0 - gains.mpc_u) * q
    n_p, integrators = K_p[-1], d
    for gain in K_p[-2::-1]:
        n_p, integrators = q * n_p + gain * integrators, d * integrators
    n_3 = q * n_p + K_3 * integrators
    b = phi_12 * gamma_2 * q + gamma_1 * e
    if gains.K_earlier is None:
        n_2 = gamma_2 * q * n_3 + K_2 * integrators
        n_1 = q * (phi_12 * n_2 + gamma_1 * e * n_3) + K_1 * e * integrators
    else:
        n_w = q * n_3 + gains.K_earlier * integrators
        n_2 = gamma_2 * n_w + K_2 * phi_22 * integrators
        n_1 = b * n_w + (phi_12 * K_2 + e * K_1) * integrators

    weight_1 = m * gains.L[0] + gains.input_gain * gains.mpc_x[0]
    weight_2 = m * gains.L[1] + gains.input_gain * gains.mpc_x[1]
    from_I = weight_1 * n_1 + d * (weight_2 * n_2 + m * e * (gains.L[2] * n_3 + n_p))
    from_V = q * (weight_1 * q * b + d * (weight_2 * gamma_2 * q + gains.L[2] * m * e))
    if gains.K_earlier is None:
        rest = q * q * weight_2 * (gamma_1 * K_2 - gamma_2 * K_1) - (1.0 - K_1) * (m * e * d + from_V)
        rest = rest - m * (q * b * K_3 + (1.0 + q * gains.L[2]) * (q * phi_12 * K_2 + e * K_1))
    else:
        rest = q * q * (weight_2 * (K_2 * (gamma_1 - b) - gamma_2 * K_1) - weight_1 * b * K_1)
        rest = rest - (1.0 - K_1) * (m * e * d + from_V)
        late = q * b * gains.K_earlier + q * phi_12 * K_2 + e * K_1
        rest = rest - m * (q * q * b * K_3 + (1.0 + q * gains.L[2]) * late)
    if held is not None:
        late, kept = (1.0, 1.0 - K_1) if gains.K_earlier is None else (q, 1.0)
        of_wanted = gains.input_gain * jnp.sum(gains.mpc_ref) * (late * n_1 + kept * e * d * integrators)
        from_I = from_I + of_wanted * held_beat.response(held, q)
    response: Response = from_I / (integrators * rest)
    return response if gains.force_filter is None else response * filter_response(gains.force_filter, q)


def filter_response(force_filter: ForceFilter, q: Response) -> Response:
    r"""Ŷ/Y of the filter of the measured force at q = z⁻¹ [-].

    With d = 1 − q: (K_y d + q K_r T_s)/(d² + q (K_y d + K_r T_s)).
    """
    d, of_rate = 1.0 - q, force_filter.rate_gain * force_filter.T_s
    of_force = force_filter.force_gain * d
    response: Response = (of_force + q * of_rate) / (d * d + q * (of_force + of_rate))
    return response


class Filters(NamedTuple):
    """What the measurements of a loop are multiplied with at each angle."""

    force: Response
    """Measured force per displacement of the tip: sensor and tissue [N/m]."""
    damping: Response
    """Damping per velocity of the tip: low-pass and K₂ [1/s]."""


def filters(contact: Contact, q: Response) -> Filters:
    """Sensor and velocity filter of a loop at q = z⁻¹."""
    sensor = (1.0 - contact.sensor_pole) / (1.0 - contact.sensor_pole * q)
    velocity = (1.0 - contact.velocity_pole) / (1.0 - contact.velocity_pole * q)
    return Filters(sensor * contact.stiffness, velocity * contact.K2)


class ClosedLoop(NamedTuple):
    """Factors of which every answer of the closed loop is made, at each angle."""

    controller: Response
    """C, command per measured force [m/s²/N]."""
    force: Response
    """H K_s, measured force per displacement of the tip [N/m]."""
    damping: Response
    """D, damping per command [-]."""
    x: Response
    """X, displacement of the tip per command [s²]."""
    early: Response
    """What takes the delay of a command out: what acts at once is X · early per acceleration [-]."""
    whole: Response
    """1 + D − H K_s X C, by which every answer is divided [-]."""


def closed_loop(gains: Gains, contact: Contact, theta: Any) -> ClosedLoop:
    """Factors of the closed loop at angles θ = ω T_s [rad]; traceable, differentiable."""
    return closed_around(controller_response(gains, jnp.exp(-1j * theta)), contact, theta)


def closed_around(controller: Any, contact: Contact, theta: Any) -> ClosedLoop:
    """The same with any linear controller, given by its response C = V/Y at these angles [m/s²/N]."""
    x, xdot = tip_response(contact, theta)
    force, damping = filters(contact, jnp.exp(-1j * theta))
    early = jnp.exp(1j * theta * (1.0 + contact.extra_delay))
    whole = 1.0 + damping * xdot - force * x * controller
    return ClosedLoop(controller, force, damping * xdot, x, early, whole)


def tip_response(contact: Contact, theta: Any, late: Any = None) -> tuple[Response, Response]:
    r"""Tip position [s²] and velocity [s] per acceleration asked of the robot, at z = e^{jθ}.

    Args:
        contact: The world.
        theta: Angle θ = ω T_s [rad].
        late: Additional delay of the held command, any number of samples ≥ 0; a fraction f splits each
            hold in two: the older command for f T_s, the newer for the rest. None is no delay.
    """
    q = jnp.exp(-1j * theta)
    whole = 0.0 if late is None else jnp.floor(late)
    gamma_1, gamma_2 = contact.gamma
    if late is not None:
        first, second = _held(contact, 1.0 - (late - whole))
        gamma_1, gamma_2 = second + q * (gamma_1 - second), first + q * (gamma_2 - first)
    delay = jnp.exp(-1j * theta * (1.0 + contact.extra_delay + whole))
    x, xdot = _moved(contact, q, delay * gamma_1, delay * gamma_2)
    if contact.spring is not None:
        # Its force acts at once.
        at_once = _moved(contact, q, *contact.gamma)
        x = x / (1.0 + contact.spring * at_once[0])
        xdot = xdot - contact.spring * x * at_once[1]
    return x, xdot


def _moved(contact: Contact, q: Response, gamma_1: Any, gamma_2: Any) -> tuple[Response, Response]:
    """Position and velocity per acceleration that adds so much to both in one sample."""
    xdot = gamma_2 * q / (1.0 - contact.phi[1] * q)
    return q * (contact.phi[0] * xdot + gamma_1) / (1.0 - q), xdot


def _held(contact: Contact, part: Any) -> tuple[Any, Any]:
    """First and second hold integral over the last part of a sample."""
    if contact.spring is not None:
        return spring_integrals(contact.spring, part * contact.T_s)
    damping = (1.0 - contact.phi[1]) / contact.phi[0]
    return hold_integrals(damping, part * contact.T_s)


def spring_integrals(spring: Any, duration: Any) -> tuple[Any, Any]:
    """First [s] and second [s²] integral of the cosine of a tip on a spring ω² > 0 [1/s²]."""
    omega = jnp.sqrt(spring)
    half = jnp.sin(0.5 * omega * duration) / omega
    return 2.0 * half * jnp.cos(0.5 * omega * duration), 2.0 * half**2


def loop_response(
    gains: Gains, contact: Contact, theta: Any, cut_at_a: Any, late: Any = None, held: HeldBeat | None = None
) -> Response:
    r"""Open-loop L(e^{jθ}) of the negative feedback 1 + L, cut at v or at a = v − K₂ẋ [-].

    With the force loop F and the damping loop D, and F₀, D₀ the same without the added delay, cutting
    at a leaves L = F + D, cutting at v leaves L = F − F₀ D/(1 + D₀): the damping stays closed inside. The measured
    force has one way to v and one back, so cutting there is cutting at v, whose margins hold for both.

    Args:
        gains: One controller.
        contact: One world.
        theta: Angles θ = ω T_s [rad].
        cut_at_a: 1 cuts at a, 0 at v.
        late: Delay added where it is cut [samples]; None is none.
        held: What is learned of the heart's beat; None learns nothing.
    """
    q = jnp.exp(-1j * theta)
    from_force, from_velocity = filters(contact, q)
    from_force = -controller_response(gains, q, held) * from_force

    def loops(delay: Any) -> tuple[Response, Response]:
        x, xdot = tip_response(contact, theta, delay)
        return from_force * x, from_velocity * xdot

    force_now, damping_now = loops(None)
    force, damping = (force_now, damping_now) if late is None else loops(late)
    at_v = force - force_now * damping / (1.0 + damping_now)
    open_loop: Response = at_v + cut_at_a * (force + damping - at_v)
    return open_loop
