"""Joint accelerations of the arm for the engine: the law with an implicit derivative, or stock MJX."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.law import chain as arm
from jaxmpc.law.chain import Chain
from jaxmpc.law.scalar import Vector, solve_ldl
from jaxmpc.world.arm import JOINTS, model
from jaxmpc.world.robot import factored


def implicit(
    chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Any, viscous: Vector, share: Any, ops: Any
) -> Vector:
    """`world.robot.accelerate`, with a derivative that never goes through the factorisation.

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
        loaded = arm.with_point_mass(chain, tool_mass)
        links = arm.inverse_dynamics(loaded, arm.pose(loaded, q, ops), qd, qdd)
        return tuple(tau + D * (v + share * a) for tau, D, v, a in zip(links, viscous, qd, qdd, strict=True))

    dq, dqd, dtorque, *others = tangents
    _, dneeded = jax.jvp(needed, (q, qd, tool_mass, viscous, share), (dq, dqd, *others))
    return qdd, solve_ldl(factors, tuple(dt - dr for dt, dr in zip(dtorque, dneeded, strict=True)))


@lru_cache(maxsize=1)
def stock_mjx() -> Callable[..., Vector]:
    """A function like `implicit` that asks `mjx.step` on the MJCF itself; for Euler without cable mode.

    Its q̈ is what the step gained in velocity per second, so Euler's update arrives exactly where MJX does.
    """
    from mujoco import mjx

    compiled = model()
    hinges = [int(compiled.joint(joint).dofadr[0]) for joint in JOINTS]
    assert hinges == [0, 1, 2, 3], "the hinges come first in the MJCF"
    tool = compiled.body("tool").id
    carrying = [tool]
    while carrying[-1]:
        carrying.append(int(compiled.body_parentid[carrying[-1]]))
    device_model, rest = mjx.put_model(compiled, impl="jax"), mjx.make_data(compiled, impl="jax")

    def one(q: Any, qd: Any, torque: Any, tool_mass: Any, viscous: Any, share: Any) -> Any:
        dtype = jnp.result_type(q)

        def cast(leaf: Any) -> Any:
            return leaf.astype(dtype) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

        m, d = jax.tree.map(cast, (device_model, rest))
        m = m.replace(
            dof_damping=m.dof_damping.at[:4].set(viscous),
            body_mass=m.body_mass.at[tool].add(tool_mass),
            body_subtreemass=m.body_subtreemass.at[jnp.array(carrying)].add(tool_mass),
        )
        d = d.replace(
            qpos=d.qpos.at[:4].set(q), qvel=d.qvel.at[:4].set(qd), qfrc_applied=d.qfrc_applied.at[:4].set(torque)
        )
        return ((mjx.step(m, d).qvel[:4] - qd) / share).astype(dtype)

    def advance(
        chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Any, viscous: Vector, share: Any, ops: Any
    ) -> Vector:
        shape = jnp.shape(q[0])

        def rows(vector: Vector) -> Any:
            return jnp.stack([jnp.broadcast_to(x, shape).ravel() for x in vector], axis=1)

        axes = (0, 0, 0, None, None, None)
        over_cells = jax.vmap(one, axes)
        gained = over_cells(rows(q), rows(qd), rows(torque), tool_mass, jnp.stack(viscous), share)
        return tuple(column.reshape(shape) for column in gained.T)

    return advance
