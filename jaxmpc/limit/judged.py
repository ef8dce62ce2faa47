"""What any linear law leaves in a loop, from its response: the residual, its parts, the true force, chatter and M_s."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxmpc.spectra.effort import acceleration_responses
from jaxmpc.spectra.residual import Responses, force_responses, noise_grid
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.spectra.true_force import true_force_responses
from jaxmpc.stability.response import closed_around
from jaxmpc.world.contact import Contact

POINTS = 400
"""Angles of the noise below and above the bend, more than a search needs: what is told is told to 0.1 %."""


class Judged(NamedTuple):
    """One axis, root mean squares; friction follows the velocity, so the squares of the parts do not add up."""

    rms: float
    """Residual as measured [N]."""
    motion: float
    """What the heart alone would leave of it [N]."""
    friction: float
    """What friction and model error would [N]."""
    noise: float
    """What the sensor would [N]."""
    true_rms: float
    """Residual of the force on the tissue itself [N]."""
    chatter: float
    """Change of the acceleration asked, from sample to sample [m/s²]."""
    M_s: float
    """Largest sensitivity, of the cuts at v and at a [-]; ∞ when unstable."""


def judged(controller: Callable[[Any], Any], contact: Contact, spectrum: Spectrum, axis: int, M_s: float) -> Judged:
    """Judge a law in a loop; needs 64-bit JAX, and a loop that is stable for its numbers to have a meaning.

    Args:
        controller: Its response V/Y at angles θ = ω T_s.
        contact: The world.
        spectrum: What disturbs it.
        axis: Which of the three.
        M_s: Its largest sensitivity, looked for elsewhere.
    """
    theta, weights = noise_grid(POINTS)
    angles = np.concatenate([spectrum.theta, theta])
    loop = closed_around(controller(angles), contact, angles)
    measured, asked = force_responses(loop), acceleration_responses(loop)
    change = 1.0 - jnp.exp(-1j * angles)
    nervous = Responses(change * asked.heart, change * asked.acceleration, change * asked.noise)
    lines = len(spectrum.theta)

    def root(of: Responses, motion: bool = True, friction: bool = True, noise: bool = True) -> float:
        heard = motion * np.asarray(of.heart)[:lines] * spectrum.heart[axis]
        pushed = friction * np.asarray(of.acceleration)[:lines] * spectrum.acceleration[axis]
        passed = noise * spectrum.noise[axis] ** 2 * np.sum(weights * np.abs(np.asarray(of.noise)[lines:]) ** 2)
        return float(np.sqrt(0.5 * np.sum(np.abs(heard + pushed) ** 2) + passed))

    return Judged(
        root(measured),
        root(measured, friction=False, noise=False),
        root(measured, motion=False, noise=False),
        root(measured, motion=False, friction=False),
        root(true_force_responses(loop, contact)),
        root(nervous),
        M_s,
    )
