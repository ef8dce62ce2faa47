"""Frequency response of the loop: that of the controller (`stability.controller`) around the contact's.

A test holds these formulas against an independent state-space model of the whole loop, as others hold the law.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxmpc.law.gains import Gains
from jaxmpc.stability.controller import Response, TransferFunction, answer, controller_of, controller_response
from jaxmpc.stability.held_beat import HeldBeat
from jaxmpc.synthesis.plant import hold_integrals
from jaxmpc.world.contact import Contact


def turned(angle: Any) -> Response:
    """e^{j angle}; half of the operations of a complex exponential."""
    return jax.lax.complex(jnp.cos(angle), jnp.sin(angle))


class Filters(NamedTuple):
    """What the measurements of a loop are multiplied with at each angle."""

    force: Response
    """Measured force per displacement of the tip: sensor and tissue [N/m]."""
    damping: Response
    """Damping per measured velocity of the tip: low-pass and K₂ [1/s]."""


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
    return closed_around(controller_response(gains, turned(-theta)), contact, theta)


def closed_around(controller: Any, contact: Contact, theta: Any) -> ClosedLoop:
    """The same with any linear controller, given by its response C = V/Y at these angles [m/s²/N]."""
    x, velocity = tip_response(contact, theta)
    force, damping = filters(contact, turned(-theta))
    early = turned(theta * (1.0 + contact.extra_delay))
    whole = 1.0 + damping * velocity - force * x * controller
    return ClosedLoop(controller, force, damping * velocity, x, early, whole)


def tip_response(contact: Contact, theta: Any, late: Any = None) -> tuple[Response, Response]:
    r"""Tip position [s²] and its difference over T_s [s] per acceleration asked of the robot, at z = e^{jθ}.

    Args:
        contact: The world.
        theta: Angle θ = ω T_s [rad].
        late: Additional delay of the held command, any number of samples ≥ 0; a fraction f splits each
            hold in two: the older command for f T_s, the newer for the rest. None is no delay.
    """
    q = turned(-theta)
    whole = 0.0 if late is None else jnp.floor(late)
    gamma_1, gamma_2 = contact.gamma
    if late is not None:
        first, second = _held(contact, 1.0 - (late - whole))
        gamma_1, gamma_2 = second + q * (gamma_1 - second), first + q * (gamma_2 - first)
    delay = turned(-theta * (1.0 + contact.extra_delay + whole))
    moved = _moved(contact, q, delay * gamma_1, delay * gamma_2)
    if contact.spring is not None:
        # Its force acts at once.
        moved = moved / (1.0 + contact.spring * _moved(contact, q, *contact.gamma) / (1.0 - q))
    return moved / (1.0 - q), moved / contact.T_s


def _moved(contact: Contact, q: Response, gamma_1: Any, gamma_2: Any) -> Response:
    """How far the tip moves in a sample per acceleration that adds so much to position and velocity in one."""
    moved: Response = q * (contact.phi[0] * gamma_2 * q / (1.0 - contact.phi[1] * q) + gamma_1)
    return moved


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
    return loop_around(controller_of(gains, held is not None), contact, theta, cut_at_a, late, held)


def loop_around(
    controller: TransferFunction,
    contact: Contact,
    theta: Any,
    cut_at_a: Any,
    late: Any = None,
    held: HeldBeat | None = None,
) -> Response:
    """`loop_response` of a controller whose polynomials are there already."""
    q = turned(-theta)
    from_force, from_velocity = filters(contact, q)
    from_force = -answer(controller, q, held) * from_force

    def loops(delay: Any) -> tuple[Response, Response]:
        x, velocity = tip_response(contact, theta, delay)
        return from_force * x, from_velocity * velocity

    force_now, damping_now = loops(None)
    force, damping = (force_now, damping_now) if late is None else loops(late)
    at_v = force - force_now * damping / (1.0 + damping_now)
    open_loop: Response = at_v + cut_at_a * (force + damping - at_v)
    return open_loop
