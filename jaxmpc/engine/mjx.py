"""Stock MJX as an engine: the joint accelerations of `mjx.step` on the MJCF itself, for comparison."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.engine.base import CellResults, Engine, ProgramSpec, ScenarioData, scalars
from jaxmpc.engine.scan import on_arm
from jaxmpc.files.errors import InputError
from jaxmpc.law.chain import Chain
from jaxmpc.law.gains import Gains
from jaxmpc.law.scalar import Vector
from jaxmpc.world.arm import JOINTS, model
from jaxmpc.world.contact import Contact

CRASHES = "0.11.2"
"""Version of JAX whose compiler ends the process (segmentation fault) on stock MJX dealt out to several devices of a
CPU; 0.10.2 and 0.12.0.1 compile it."""


class Mjx(Engine):
    """The arm on stock MJX, which steps as MuJoCo's Euler does; no substeps, no cable mode."""

    name = "mjx"
    integrators = ("euler",)
    physics = ("mjx",)
    text = "the arm on stock MJX"

    def unfit(self) -> str:
        """See `Engine.unfit`."""
        crashes = jax.__version__ == CRASHES and jax.default_backend() == "cpu" and jax.local_device_count() > 1
        return f"needs another version of jax than {CRASHES}, which crashes on it" if crashes else super().unfit()

    def simulate(
        self,
        spec: ProgramSpec,
        gains: Gains,
        K2: Any,
        contacts: Contact | None,
        data: ScenarioData,
        dtype: Any,
        traced: bool = False,
    ) -> CellResults:
        """See `Engine.simulate`.

        Raises:
            InputError: This version of JAX would crash.
        """
        del contacts
        if self.unfit():
            remedy = 'Take another version of jax, or physics = "wam", which agrees with it.'
            raise InputError("physics", "mjx", f"another one with jax {CRASHES}, which crashes on it", remedy)
        gains = scalars(gains, spec.preview)
        return on_arm(spec, accelerate, lambda step, one: step, gains, K2, data, dtype, traced)


def accelerate(
    chain: Chain, q: Vector, qd: Vector, torque: Vector, tool_mass: Any, viscous: Vector, share: Any, ops: Any
) -> Vector:
    """`jaxmpc.world.joint_acceleration.accelerate` by stock MJX; for Euler without cable mode.

    Its q̈ is what the step gained in velocity per second, so Euler's update arrives exactly where MJX does.
    """
    del chain, ops
    shape = jnp.shape(q[0])

    def rows(vector: Vector) -> Any:
        return jnp.stack([jnp.broadcast_to(x, shape).ravel() for x in vector], axis=1)

    gained = jax.vmap(_gained, (0, 0, 0, None, None, None))
    found = gained(rows(q), rows(qd), rows(torque), tool_mass, jnp.stack(viscous), share)
    return tuple(column.reshape(shape) for column in found.T)


def _gained(q: Any, qd: Any, torque: Any, tool_mass: Any, viscous: Any, share: Any) -> Any:
    """Velocity gained per second in one step of MJX, (4,) [rad/s²]."""
    from mujoco import mjx

    dtype = jnp.result_type(q)

    def cast(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    whole, rest, carrying = _stock()
    m, d = jax.tree.map(cast, (whole, rest))
    m = m.replace(
        opt=m.opt.replace(timestep=jnp.asarray(share, m.opt.timestep.dtype)),
        dof_damping=m.dof_damping.at[:4].set(viscous),
        body_mass=m.body_mass.at[carrying[0]].add(tool_mass),
        body_subtreemass=m.body_subtreemass.at[np.array(carrying)].add(tool_mass),
    )
    d = d.replace(qpos=d.qpos.at[:4].set(q), qvel=d.qvel.at[:4].set(qd), qfrc_applied=d.qfrc_applied.at[:4].set(torque))
    return ((mjx.step(m, d).qvel[:4] - qd) / share).astype(dtype)


@lru_cache(maxsize=1)
def _stock() -> tuple[Any, Any, tuple[int, ...]]:
    """MJX's model and data, and the bodies from the tool to the world.

    Made in float64 and outside of whatever trace is under way: what one trace has made no other may use.
    """
    from mujoco import mjx

    compiled = model()
    hinges = [int(compiled.joint(joint).dofadr[0]) for joint in JOINTS]
    assert hinges == [0, 1, 2, 3], "the hinges come first in the MJCF"
    carrying = [int(compiled.body("tool").id)]
    while carrying[-1]:
        carrying.append(int(compiled.body_parentid[carrying[-1]]))
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        made = mjx.put_model(compiled, impl="jax"), mjx.make_data(compiled, impl="jax")
    return *made, tuple(carrying)
