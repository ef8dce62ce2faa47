r"""Friction that the controller cancels without a model of it: what disturbs the momentum of the joints.

With the nominal model's momentum p = Mₙ q̇, armature included, and n = τ − cₙ − Jᵀy, all that it knows of Mₙ q̈,

    r = K (p − ∫ (n + Ṁₙ q̇ + r) dt),   τ −= r          Mₙ q̈ = n + d:   ṙ = K (d − r)

From one sample to the next p − ∫ Ṁₙ q̇ dt changes by Mₙ Δq̇, so that neither Ṁₙ nor Cᵀq̇ is needed and no integral grows:

    rₖ = rₖ₋₁ + K (Mₙ (q̇ₖ − q̇ₖ₋₁) − T_s fₖ)
    fₖ = p fₖ₋₁ + (1 − p) (wₖ₋₂ + wₖ₋₃)/2,   w = n + r

f is w as the measured velocity shows it: a torque acts a sample after it is asked for, a difference of differences of
angles weighs two samples, and the velocity's low-pass has the pole p. Without f a part of what the cascades ask for
would count as a disturbance, and change the loop's gain. So a constant d is cancelled whole, late by 1/K in the mean:
∫ (1 − r/d) dt = 1/K where r acts. n is the torque that the limits let pass, less cₙ and Jᵀy of the sample at which it
was asked for; that y arrives late is a part of d.

All that is not in n is d, whatever makes it: friction, wrong masses, a payload, a hand on the elbow. A share of n that
wrong masses leave in d, a second sample of delay and cables cost margin (`stability.whole_arm` has them). The active
state p̂ estimates the same at the tip, from the force. While the model is right, the cascades meet the arm that they
are designed for; r takes d first and p̂ what r is late for, and the loop's answer to d is the cascades' times what r
leaves. Both vanish for a constant d, and where both are late, between K/2 and 2 K, r leaves more than d. It acts in
contact alone, where it begins at r = 0: a servo must not grow stronger against what is in its way.

Source: De Luca and Mattone, ICRA 2005, eq. (14); cancelled as in Ohnishi, Shibata and Murakami, IEEE/ASME Trans.
Mechatronics 1(1), 1996.
"""

from typing import NamedTuple

from jaxmpc.law.measurement import Measurement
from jaxmpc.law.scalar import Matrix, Scalar, Vector, add, apply, scale, sub

FASTEST = 100.0
"""Largest bandwidth K [rad/s]: beyond it encoders' counts shake the torques."""
SAMPLED = 0.5, 0.3
"""Largest K T_s where torques act after one sample, and after two [-]: from 0.67 and 0.4 on r may swing by itself,
without end, by the velocity's low-pass; at 0.83 and 0.54 it does behind any."""


class MomentumState(NamedTuple):
    """What is remembered between two samples; 4 scalars each."""

    residual: Vector
    """r, the disturbance [N m]."""
    expected: Vector
    """f of the next sample [N m]."""
    velocity: Vector
    """q̇ of the last sample [rad/s]."""
    accelerating: Vector
    """w of the last sample [N m]. After a clamp, add what it changed."""
    before: Vector
    """w of the one before [N m]."""


def fastest(T_s: float, delay: int) -> float:
    """Largest bandwidth [rad/s] at a sampling time [s], where torques act after 1 or 2 samples."""
    return min(FASTEST, SAMPLED[delay - 1] / T_s)


def init(velocity: Vector) -> MomentumState:
    """Joints that nothing accelerates or disturbs, at measured velocities [rad/s]."""
    none = tuple(0.0 * joint for joint in velocity)
    return MomentumState(none, none, velocity, none, none)


def step(
    bandwidth: Scalar, measurement: Measurement, state: MomentumState, mass: Matrix, velocity: Vector, wanted: Vector
) -> MomentumState:
    """Advance by one sample.

    Args:
        bandwidth: K [rad/s].
        measurement: How the velocities come about.
        state: What `init` or the last `step` returned, told what the limits let pass.
        mass: Nominal mass matrix Mₙ, armature included [kg m²].
        velocity: Measured joint velocities q̇, 4 scalars [rad/s].
        wanted: Torque that is to accelerate the arm, 4 scalars: w, if no limit acts [N m].
    """
    T_s, pole = measurement
    gained = sub(apply(mass, sub(velocity, state.velocity)), scale(T_s, state.expected))
    acting = scale(0.5, add(state.accelerating, state.before))
    return MomentumState(
        residual=add(state.residual, scale(bandwidth, gained)),
        expected=add(acting, scale(pole, sub(state.expected, acting))),
        velocity=velocity,
        accelerating=wanted,
        before=state.accelerating,
    )
