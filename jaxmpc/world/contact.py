"""The linear contact loop of one axis: tip, tissue, force sensor and delay, as scalar arithmetic.

Exact between samples, because the command is held and the heart moves the force only at the samples:

    xₖ₊₁ = xₖ + φ₁₂ ẋₖ + γ₁ aₖ₋d,   ẋₖ₊₁ = φ₂₂ ẋₖ + γ₂ aₖ₋d,   yₖ = K_s (xₖ − x_heart,ₖ)

with aₖ = vₖ for the paper's ideal damping (6), which then sits in φ and γ, or aₖ = vₖ − K₂ ẋ_f,ₖ for damping through
the measured velocity, delayed like every command: a low-pass behind (xₖ − xₖ₋₁)/T_s, the difference of positions that
encoders give (`jaxmpc.law.measurement`), half a sample older than ẋₖ. A disturbance acceleration wₖ, held
like a command but not delayed, adds to aₖ₋d. A spring adds −ω² xₖ in the same way (`jaxmpc.stability.presliding`).
"""

from math import pi
from typing import Any, NamedTuple

Scalar = Any


class Contact(NamedTuple):
    """Constants of one axis; each may be a batch."""

    T_s: Scalar
    """Sampling time [s]."""
    stiffness: Scalar
    """Stiffness of the tissue K_s [N/m]."""
    phi: tuple[Scalar, Scalar]
    """φ₁₂ [s] and φ₂₂ [-]."""
    gamma: tuple[Scalar, Scalar]
    """γ₁ [s²] and γ₂ [s]."""
    K2: Scalar
    """Damping fed back from the measured velocity [1/s]; 0 with ideal damping."""
    velocity_pole: Scalar
    """Pole of the velocity low-pass [-]; 0 passes everything."""
    sensor_pole: Scalar
    """Pole of the force sensor's low-pass [-]; 0 passes everything."""
    extra_delay: Scalar
    """0 for a delay of one sample, 1 for two."""
    spring: Scalar | None = None
    """Spring that holds the tip besides the tissue, ω² [1/s²], for which φ and γ are made; None costs nothing."""


class ContactState(NamedTuple):
    """What one axis of the world remembers between two samples."""

    x: Scalar
    """Tip position [m]."""
    xdot: Scalar
    """Tip velocity [m/s]."""
    moved: Scalar
    """How far the tip has moved since the last sample [m]."""
    velocity: Scalar
    """Filtered velocity measurement [m/s]."""
    force: Scalar
    """Filtered force [N]."""
    pending: tuple[Scalar, Scalar]
    """Commands of the last two samples, newest first [m/s²]."""


def init(x: Scalar = 0.0) -> ContactState:
    """A tip at rest at x [m], touching without force."""
    zero = 0.0 * x
    return ContactState(x, zero, zero, zero, zero, (zero, zero))


def hertz(frequency: float) -> float:
    """Angular frequency [rad/s] of a frequency [Hz]."""
    return 2.0 * pi * frequency


def true_force(contact: Contact, state: ContactState, heart: Scalar) -> Scalar:
    """Force on the tissue at a sample [N]; arguments as for `sense`."""
    return contact.stiffness * (state.x - heart)


def sense(contact: Contact, state: ContactState, heart: Scalar) -> tuple[Scalar, ContactState]:
    """Force before noise and quantisation [N], with the filters moved on by one sample.

    Args:
        contact: Constants.
        state: State at the sample.
        heart: Position of the heart's surface [m].
    """
    true = true_force(contact, state, heart)
    force = true + contact.sensor_pole * (state.force - true)
    measured = state.moved / contact.T_s
    velocity = measured + contact.velocity_pole * (state.velocity - measured)
    return force, state._replace(force=force, velocity=velocity)


def move(
    contact: Contact, state: ContactState, v: Scalar, disturbance: Scalar | None = None
) -> tuple[ContactState, Scalar]:
    """Take a command v [m/s²] and advance to the next sample.

    Args:
        contact: Constants.
        state: State that `sense` returned.
        v: Acceleration command of the cascade [m/s²].
        disturbance: What accelerates the tip besides, at once and until the next sample [m/s²]; None is nothing.

    Returns:
        The next state, and the acceleration asked of the robot a = v − K₂ẋ [m/s²].
    """
    a = v - contact.K2 * state.velocity
    newest, older = state.pending
    applied = newest + contact.extra_delay * (older - newest)
    if disturbance is not None:
        applied = applied + disturbance
    if contact.spring is not None:
        applied = applied - contact.spring * state.x
    moved = contact.phi[0] * state.xdot + contact.gamma[0] * applied
    xdot = contact.phi[1] * state.xdot + contact.gamma[1] * applied
    return state._replace(x=state.x + moved, xdot=xdot, moved=moved, pending=(a, newest)), a
