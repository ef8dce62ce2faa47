"""Joint angles and velocities as the law sees them: backward differences of the encoders' angles behind a low-pass.

q̇ₖ = d + p (q̇ₖ₋₁ − d),   d = (qₖ − qₖ₋₁)/T_s,   p = e^(−ω T_s)
"""

from typing import NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, scale, sub


class Measurement(NamedTuple):
    """Constants; each may be a batch."""

    T_s: Scalar
    """Sampling time [s]."""
    velocity_pole: Scalar
    """Pole p of the velocity's low-pass [-]; 0 passes everything."""


class MeasurementState(NamedTuple):
    """What is known of the joints at a sample, and all that is remembered of earlier ones."""

    angle: Vector
    """Measured joint angles [rad]."""
    velocity: Vector
    """Filtered joint velocities [rad/s]."""


def lowpass_pole(cutoff: Scalar, T_s: Scalar, ops: Ops) -> Scalar:
    """Pole of a first-order low-pass with a cut-off [rad/s]; 0, which passes everything, for the cut-off 0."""
    return ops.where(cutoff > 0.0, ops.exp(-cutoff * T_s), 0.0)


def with_cutoff(constants: Measurement, cutoff: Scalar | None, ops: Ops) -> Measurement:
    """The same behind a controller's own low-pass [rad/s]; None leaves it as it is."""
    if cutoff is None:
        return constants
    return constants._replace(velocity_pole=lowpass_pole(cutoff, constants.T_s, ops))


def init(angle: Vector) -> MeasurementState:
    """Joints at rest at measured angles [rad]."""
    return MeasurementState(angle, tuple(0.0 * joint for joint in angle))


def measure(constants: Measurement, state: MeasurementState, q: Vector) -> MeasurementState:
    """Advance by one sample, in which the encoders read joint angles q [rad]."""
    raw = scale(1.0 / constants.T_s, sub(q, state.angle))
    pole = constants.velocity_pole
    return MeasurementState(q, tuple(new + pole * (old - new) for new, old in zip(raw, state.velocity, strict=True)))
