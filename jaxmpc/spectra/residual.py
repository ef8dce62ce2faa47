r"""The residual of a controller from its frequency response, without a time step.

With the tip X₀ and its velocity V₀ per acceleration that acts at once, the same X, V per command (delayed), the
sensor's low-pass H, the controller C = V/Y and the damping loop D = K₂ H_v V, a force y is measured of

    y = [(1 + D)(n − H K_s x_heart) + H K_s X₀ w] / (1 + D − H K_s X C)

for heart x_heart, disturbance acceleration w and noise n. A spectrum of many lines has the mean square ½ Σ|y|².

It sees a linear loop: no rounding but as white noise, no saturation, no friction that answers to the controller.
"""

from collections.abc import Callable
from math import pi
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from jaxmpc.law.gains import Gains
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.stability.controller import Response
from jaxmpc.stability.response import ClosedLoop, closed_loop
from jaxmpc.world.contact import Contact

LOWEST, BEND, POINTS = 1e-3, 0.2, 96
"""The noise is summed at so many angles from `LOWEST` up to `BEND` in equal ratios, and as many from there to π [rad].
Below, integral action leaves none; resonances lie below the bend. Good to 0.5 % of the RMS up to M_s = 5, 2 % to 10."""
HIGHEST_GAIN = 1e12
"""A design with a larger gain, or none, has failed; its loop counts as open, so that slopes stay finite."""


class Responses(NamedTuple):
    """What is looked at, per disturbance: of the measured force, units as here."""

    heart: Response
    """Per motion of the heart [N/m]."""
    acceleration: Response
    """Per disturbance acceleration [N s²/m]."""
    noise: Response
    """Per noise of the sensor [-]."""


Answer = Callable[[Gains, Contact, Any], Responses]
"""Responses of a controller in a world at angles θ [rad]."""


class Parts(NamedTuple):
    """Residual RMS that each disturbance alone would leave, per axis (3,) [N].

    Heart and friction are correlated: friction follows the velocity. So the squares do not add up to the whole.
    """

    motion: Float[Array, "3"]
    friction: Float[Array, "3"]
    """And model error."""
    noise: Float[Array, "3"]


def responses(gains: Gains, contact: Contact, theta: Any) -> Responses:
    """How the closed loop answers at angles θ = ω T_s [rad]; traceable, differentiable."""
    return force_responses(closed_loop(gains, contact, theta))


def force_responses(loop: ClosedLoop) -> Responses:
    """What is measured of the force, of any closed loop."""
    noise = (1.0 + loop.damping) / loop.whole
    return Responses(-noise * loop.force, loop.force * loop.x * loop.early / loop.whole, noise)


def residual_rms(gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """Residual e = y_measured − F_d per axis, root mean square [N]; float64, traceable, differentiable.

    Finite, but without meaning, for an unstable loop: ask `margins_one` for that.

    Args:
        gains: One controller.
        contact: One world, with ideal or sampled damping.
        spectrum: What disturbs it.
    """
    return root_mean_square(responses, gains, contact, spectrum)


def root_mean_square(of: Answer, gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """Root mean square per axis of anything that answers linearly; the rest as for `residual_rms`."""
    answer, noise = _answers(of, gains, contact, spectrum)
    whole = answer.heart * spectrum.heart + answer.acceleration * spectrum.acceleration
    return _root(_mean_square(whole) + noise)


def residual_parts(gains: Gains, contact: Contact, spectrum: Spectrum) -> Parts:
    """The residual by its causes; arguments as for `residual_rms`."""
    answer, noise = _answers(responses, gains, contact, spectrum)
    motion, friction = answer.heart * spectrum.heart, answer.acceleration * spectrum.acceleration
    return Parts(_root(_mean_square(motion)), _root(_mean_square(friction)), _root(noise))


def _answers(of: Answer, gains: Gains, contact: Contact, spectrum: Spectrum) -> tuple[Responses, Float[Array, "3"]]:
    """Responses at the lines, and the variance that the noise leaves."""
    sound = jnp.all(jnp.array([jnp.all(jnp.abs(gain) < HIGHEST_GAIN) for gain in jax.tree.leaves(gains)]))
    gains = jax.tree.map(lambda gain: jnp.where(sound, gain, 0.0), gains)
    theta, weights = noise_grid()
    answer = of(gains, contact, jnp.concatenate([jnp.asarray(spectrum.theta), theta]))
    lines = len(spectrum.theta)
    passed = jnp.sum(weights * _squared(answer.noise[lines:]))
    at_lines = Responses(*(field[:lines] for field in answer))
    return at_lines, passed * spectrum.noise**2


def noise_grid(points: int = POINTS) -> tuple[Float[np.ndarray, " angles"], Float[np.ndarray, " angles"]]:
    """Angles from 0 to π and the weights of a mean over them, by trapezoids; so many below the bend and above."""
    theta = np.concatenate([np.geomspace(LOWEST, BEND, points, endpoint=False), np.linspace(BEND, pi, points)])
    steps = np.diff(theta, prepend=0.0)
    return theta, 0.5 * (steps + np.append(steps[1:], 0.0)) / pi


def _squared(value: Complex[Array, "..."]) -> Float[Array, "..."]:
    # Not through the absolute value, whose slope at 0 is NaN.
    return value.real**2 + value.imag**2


def _mean_square(amplitudes: Complex[Array, "3 lines"]) -> Float[Array, "3"]:
    return 0.5 * jnp.sum(_squared(amplitudes), axis=1)


def _root(mean_square: Float[Array, "3"]) -> Float[Array, "3"]:
    # The slope of a root at 0 is infinite; a loop that nothing disturbs has none to tune.
    return jnp.where(mean_square > 0.0, jnp.sqrt(jnp.where(mean_square > 0.0, mean_square, 1.0)), mean_square)
