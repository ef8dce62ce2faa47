r"""Acceleration that a controller asks of the robot, from its frequency response: how hard, and how nervously.

In the notation of `residual`, with V, V₀ the tip's velocity per command and per acceleration that acts at once,

    a = [C (n − H K_s x_heart) + (C H K_s X₀ − K₂ H_v V₀) w] / (1 + D − H K_s X C)

and its change per sample is (1 − z⁻¹) a. What a motion needs is the same for every controller that follows it, and
small from sample to sample. What becomes of the sensor's noise is the controller's own doing: chatter is nearly that
alone, and the computed torque hands it on to the joints at once.

Not in it: a constant acceleration, which the lines of a spectrum leave out, and the steps of the encoders, which reach
a through K₂ and the velocity's low-pass.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.law.gains import Gains
from jaxmpc.spectra.residual import Responses, root_mean_square
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.stability.response import ClosedLoop, closed_loop
from jaxmpc.world.contact import Contact


def effort_rms(gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """Acceleration asked of the robot per axis, root mean square [m/s²]: `Metrics.effort` without a time step.

    Float64, traceable, differentiable; arguments, and what it means for an unstable loop, as for `residual_rms`.
    """
    return root_mean_square(effort_responses, gains, contact, spectrum)


def chatter_rms(gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """Its change from sample to sample, root mean square [m/s²]: `Metrics.chatter`; the rest as for `effort_rms`."""
    return root_mean_square(chatter_responses, gains, contact, spectrum)


def effort_responses(gains: Gains, contact: Contact, theta: Any) -> Responses:
    """Acceleration asked of the robot per heart [1/s²], disturbance acceleration [-] and noise [m/s²/N].

    Args:
        gains: One controller.
        contact: One world.
        theta: Angles θ = ω T_s [rad].
    """
    return acceleration_responses(closed_loop(gains, contact, theta))


def acceleration_responses(loop: ClosedLoop) -> Responses:
    """What is asked of the robot, by any closed loop; units as for `effort_responses`."""
    noise = loop.controller / loop.whole
    return Responses(-loop.force * noise, loop.early * (loop.force * loop.x * noise - loop.damping / loop.whole), noise)


def chatter_responses(gains: Gains, contact: Contact, theta: Any) -> Responses:
    """Its change from sample to sample; units as for `effort_responses`."""
    heart, acceleration, noise = effort_responses(gains, contact, theta)
    d = 1.0 - jnp.exp(-1j * theta)
    return Responses(d * heart, d * acceleration, d * noise)
