r"""The force on the tissue itself from the frequency response: what the sensor adds to it and takes away is left out.

In the notation of `residual` the sensor reads y = H y_true + n, so that

    y_true = (y − n) / H

of which the noise has only the part that the controller turns into motion.
"""

from typing import Any

from jaxtyping import Array, Float

from jaxmpc import swing
from jaxmpc.law.gains import Gains
from jaxmpc.spectra.residual import Responses, force_responses, root_mean_square
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.stability.response import ClosedLoop, closed_loop
from jaxmpc.world.contact import Contact
from jaxmpc.xla import ops


def true_rms(gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """Residual of the true force per axis, root mean square [N]: `Metrics.true_rms` without a time step.

    Float64, traceable, differentiable; arguments, and what it means for an unstable loop, as for `residual_rms`.
    """
    return root_mean_square(true_responses, gains, contact, spectrum)


def swing_rms(gains: Gains, contact: Contact, spectrum: Spectrum) -> Float[Array, "3"]:
    """True force above 12 Hz per axis, root mean square [N]: `Metrics.swing`; the rest as for `true_rms`."""
    return root_mean_square(swing_responses, gains, contact, spectrum)


def true_responses(gains: Gains, contact: Contact, theta: Any) -> Responses:
    """How the true force answers at angles θ = ω T_s [rad]; units as of `Responses`."""
    return true_force_responses(closed_loop(gains, contact, theta), contact)


def true_force_responses(loop: ClosedLoop, contact: Contact) -> Responses:
    """The same of any closed loop."""
    heart, acceleration, noise = force_responses(loop)
    sensor = loop.force / contact.stiffness
    return Responses(heart / sensor, acceleration / sensor, (noise - 1.0) / sensor)


def swing_responses(gains: Gains, contact: Contact, theta: Any) -> Responses:
    """The same above 12 Hz."""
    passed = swing.gain(theta, contact.T_s, ops)
    heart, acceleration, noise = true_responses(gains, contact, theta)
    return Responses(passed * heart, passed * acceleration, passed * noise)
