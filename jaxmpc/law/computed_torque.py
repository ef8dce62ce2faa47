"""Computed torque in task space: from the acceleration wanted at the tip to joint torques.

With [P] the paper, y the measured force on the tissue (F_e = −y acts on the robot), a the acceleration wanted,
and nominal Mₙ, cₙ that may differ from the arm's:

    w = a − J̇q̇ − J q̈₀,   Λ = (J Mₙ⁻¹ Jᵀ)⁻¹
    τ = Mₙ q̈₀ + Jᵀ (Λ w + y) + cₙ + τ_f                      [P] (1)–(4)
    q̈₀ = −20 (q − q_posture) − 9 q̇                            holds the redundant joint

which is τ = Mₙ q̈ + cₙ + Jᵀ y with J q̈ = a − J̇q̇, and q̈₀ in the null space of J.
"""

from typing import NamedTuple

from jaxmpc.law.chain import Chain, dynamics, pose, tip, with_diagonal, with_point_mass
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import (
    Matrix,
    Scalar,
    Vector,
    add,
    apply,
    apply_transposed,
    factor_ldl,
    matmul,
    scale,
    solve_ldl,
    solve_lower,
    sub,
    times,
    transpose,
)

POSTURE_STIFFNESS, POSTURE_DAMPING = 20.0, 9.0
"""Null-space posture: acceleration per angle [1/s²] and per velocity [1/s]; critically damped."""


class Nominal(NamedTuple):
    """How the controller's model of the arm differs from its chain; each scalar may be a batch."""

    mass_scale: Scalar
    """Mass and inertia of links and tool, as a share of the chain's [-]."""
    tool_error: Scalar
    """Point mass at the tip that the model has besides, as for a tool that is not the chain's [kg]."""
    friction: NominalFriction
    """What is cancelled of the joints' friction, if any."""


class JointTorque(NamedTuple):
    """Torques, and what is needed to say what a changed torque means at the tip."""

    torque: Vector
    """Joint torques τ [N m]."""
    lower: Matrix
    """L of the nominal mass matrix LDLᵀ."""
    response: Matrix
    """J L⁻ᵀ D⁻¹, what L⁻¹ of a torque accelerates the tip [m/(N m s²)]."""
    mass: Matrix = ()
    """Nominal mass matrix, armature included [kg m²]."""
    load: Vector = ()
    """What of the torques holds the arm where it is, cₙ + Jᵀy [N m]."""


def tip_velocity(chain: Chain, q: Vector, qd: Vector, ops: Ops) -> Vector:
    """Velocity of the tip [m/s] at measured joint angles [rad] and velocities [rad/s]."""
    return apply(tip(chain, pose(chain, q, ops)).jacobian, qd)


def torque(
    chain: Chain,
    nominal: Nominal,
    posture: Vector,
    q: Vector,
    qd: Vector,
    a: Vector,
    force: Vector,
    friction: Vector,
    ops: Ops,
) -> JointTorque:
    """Joint torques for a wanted acceleration of the tip.

    Args:
        chain: The arm.
        nominal: How the model of it differs.
        posture: Joint angles at which the null space rests, 4 scalars [rad].
        q: Measured joint angles, 4 scalars [rad].
        qd: Measured joint velocities, 4 scalars [rad/s].
        a: Wanted acceleration, 3 scalars [m/s²].
        force: Measured force on the tissue, 3 scalars [N].
        friction: Torques that cancel the friction τ_f, 4 scalars [N m].
        ops: Scalar functions.
    """
    share = nominal.mass_scale
    model = with_point_mass(chain, nominal.tool_error / share)
    at = pose(model, q, ops)
    J = tip(model, at).jacobian
    found = dynamics(model, at, qd)
    mass = with_diagonal(tuple(scale(share, row) for row in found.mass), chain.armature)
    bias = scale(share, found.bias)

    posture_acceleration = sub(
        scale(-POSTURE_STIFFNESS, sub(q, posture)),
        scale(POSTURE_DAMPING, qd),
    )
    lower, inverse = factor_ldl(mass)
    # J M⁻¹ Jᵀ = Y D⁻¹ Yᵀ with M = L D Lᵀ and Y = J L⁻ᵀ.
    half = tuple(solve_lower(lower, row) for row in J)
    response = tuple(tuple(map(times, row, inverse)) for row in half)
    mobility = matmul(half, transpose(response))
    w = sub(sub(a, found.drift), apply(J, posture_acceleration))
    at_the_tip = add(solve_ldl(factor_ldl(mobility), w), force)
    tau = add(add(apply(mass, posture_acceleration), bias), apply_transposed(J, at_the_tip))
    load = add(bias, apply_transposed(J, force))
    return JointTorque(add(tau, friction), lower, response, mass, load)


def acceleration_of(found: JointTorque, change: Vector) -> Vector:
    """Acceleration of the tip [m/s²] that a change of the joint torques [N m] makes, on the nominal model."""
    return apply(found.response, solve_lower(found.lower, change))
