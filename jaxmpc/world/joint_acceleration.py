"""Joint accelerations of the arm: its equation of motion with implicit viscous friction, and the plain way to solve."""

from collections.abc import Callable
from typing import Any

from jaxmpc.law.chain import Chain, dynamics, pose, with_diagonal, with_point_mass
from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, factor_ldl, plus, solve_ldl, sub, times

Accelerate = Callable[..., Vector]
"""Like `accelerate` below."""


def accelerate(
    chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Scalar, viscous: Vector, share: Scalar, ops: Ops
) -> Vector:
    """q̈ of (M + share D) q̈ = τ − c − D q̇ [rad/s²]; the plain form, for any kind of scalar.

    Args:
        chain: The arm.
        q: Joint angles, 4 scalars [rad].
        qd: Joint velocities, 4 scalars [rad/s].
        torque: Joint torques τ, 4 scalars [N m].
        tool_mass: Point mass at the tip beyond the chain's own [kg].
        viscous: Viscous friction D, 4 scalars [N m s/rad].
        share: Time over which it is implicit [s].
        ops: Scalar functions.
    """
    return solve_ldl(*factored(chain, q, qd, torque, tool_mass, viscous, share, ops))


def factored(
    chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Scalar, viscous: Vector, share: Scalar, ops: Ops
) -> tuple[Any, Vector]:
    """The equation that `accelerate` solves: factors of its left side, and its right side."""
    loaded = with_point_mass(chain, tool_mass)
    found = dynamics(loaded, pose(loaded, q, ops), qd)
    diagonal = tuple(plus(A, times(share, D)) for A, D in zip(chain.armature, viscous, strict=True))
    rest = sub(sub(torque, found.bias), tuple(map(times, viscous, qd)))
    return factor_ldl(with_diagonal(found.mass, diagonal)), rest
