"""Joint accelerations of the arm with an implicit derivative."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.law.chain import Chain, inverse_dynamics, pose, with_point_mass
from jaxmpc.law.scalar import Vector, solve_ldl
from jaxmpc.world.joint_acceleration import factored


def implicit(
    chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Any, viscous: Vector, share: Any, ops: Any
) -> Vector:
    """`jaxmpc.world.joint_acceleration.accelerate`, with a derivative that never goes through the factorisation.

    From r(q, q̇, q̈) = (M + share D) q̈ + c + D q̇ = τ follows dq̈ = (M + share D)⁻¹ (dτ − dr at fixed q̈): the tangent
    of one Newton–Euler recursion and one more solve with the same factors. The rule is linear in the tangents,
    so it serves both modes.
    """
    found: Vector = _implicit((chain, ops), q, qd, torque, jnp.asarray(tool_mass), viscous, share)
    return found


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _implicit(fixed: Any, q: Vector, qd: Vector, torque: Vector, tool_mass: Any, viscous: Vector, share: Any) -> Vector:
    chain, ops = fixed
    factors, rest = factored(chain, q, qd, torque, tool_mass, viscous, share, ops)
    return solve_ldl(factors, rest)


@_implicit.defjvp
def _implicit_jvp(fixed: Any, primals: Any, tangents: Any) -> tuple[Vector, Vector]:
    chain, ops = fixed
    q, qd, torque, tool_mass, viscous, share = primals
    factors, rest = factored(chain, q, qd, torque, tool_mass, viscous, share, ops)
    qdd = solve_ldl(factors, rest)

    def needed(q: Vector, qd: Vector, tool_mass: Any, viscous: Vector, share: Any) -> Vector:
        loaded = with_point_mass(chain, tool_mass)
        links = inverse_dynamics(loaded, pose(loaded, q, ops), qd, qdd)
        return tuple(tau + D * (v + share * a) for tau, D, v, a in zip(links, viscous, qd, qdd, strict=True))

    dq, dqd, dtorque, *others = tangents
    _, dneeded = jax.jvp(needed, (q, qd, tool_mass, viscous, share), (dq, dqd, *others))
    return qdd, solve_ldl(factors, tuple(dt - dr for dt, dr in zip(dtorque, dneeded, strict=True)))
