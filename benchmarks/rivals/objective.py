"""The tuner's objective without its gradient, for any controller that the cascade's law can express.

The benchmark refuses to start unless both give the same number.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array

from benchmarks.rivals import pi
from tuning.job.space import SearchSpace
from tuning.objective.designed import Data, Designed, ProblemStructure, designed, worlds_of
from tuning.objective.loss import evaluate_goals
from tuning.objective.problem import Problem

BATCH = 16
"""Controllers at a time: fewer take as long, more are no faster each (measured)."""
Law = Callable[[Array, Data, ProblemStructure], Designed]
"""The controller that an unconstrained vector stands for."""
LOST = 1e3
"""Loss of a controller whose runs left the finite numbers [-]."""


class Seen(NamedTuple):
    """What the objective says of controllers, each (controllers,)."""

    loss: Any
    """log risk and penalties [-]."""
    score: Any
    """Risk of the soft goals [-]; NaN where unstable."""
    hard: Any
    """Largest normalised hard goal [-]; met at 1 and below."""


def evaluator(problem: Problem, law: Law, rows: int = BATCH) -> Callable[[np.ndarray], Seen]:
    """The objective of any number of unconstrained vectors (n, size), so many at a time on all devices.

    Args:
        problem: The tuner's problem on its last level.
        law: What a vector stands for: `mpc_aob` or `pi_control`.
        rows: How many at a time.
    """
    program, devices = _program(problem.kind, law)
    rows = -(-rows // devices) * devices

    def evaluate(z: np.ndarray) -> Seen:
        parts = []
        for first in range(0, len(z), rows):
            part = z[np.minimum(np.arange(first, first + rows), len(z) - 1)]
            parts.append(jax.tree.map(np.asarray, program(part, problem.data)))
        found: Seen = jax.tree.map(lambda *fields: np.concatenate(fields)[: len(z)], *parts)
        return found._replace(loss=np.nan_to_num(found.loss, nan=LOST, posinf=LOST))

    return evaluate


@cache
def _program(kind: ProblemStructure, law: Law) -> tuple[Callable[..., Seen], int]:
    """Compiled once per kind and law, and on how many devices it runs."""
    spec: Any = PartitionSpec

    def on_device(z: Array, data: Data) -> Seen:
        return judged(jax.vmap(lambda vector: law(vector, data, kind))(z), data, kind)

    mesh = Mesh(np.array(jax.local_devices()), ("device",))
    split = spec("device")
    mapped = jax.shard_map(on_device, mesh=mesh, in_specs=(split, spec()), out_specs=split, check_vma=False)
    program: Callable[..., Seen] = jax.jit(mapped)
    return program, mesh.size


def mpc_aob(z: Array, data: Data, kind: ProblemStructure) -> Designed:
    """The tuner's own controller; traceable."""
    return designed(SearchSpace(data.base, kind.axes).decode(z, 1.0), data, 1.0)


def pi_control(z: Array, data: Data, kind: ProblemStructure) -> Designed:
    """The PI controller with damping, in the same worlds and judged at the same margins; traceable."""
    found = pi.decode(z)
    gains = pi.gains(found, data.scene.path.T_s)
    damped = eqx.tree_at(lambda params: params.K2, data.base, found.K2)
    return Designed(damped, gains, *worlds_of(gains, found.K2, data))


def judged(controllers: Designed, data: Data, kind: ProblemStructure) -> Seen:
    """Loss of designed controllers, as the tuner has it; traceable."""
    found = evaluate_goals(controllers, data, kind)
    worst = jnp.max(jnp.stack([jnp.max(found.margins.normalised, axis=(1, 2), initial=0.0), *found.hard]), axis=0)
    return Seen(found.loss, jnp.where(found.stable, found.risk, jnp.nan), jnp.where(found.stable, worst, jnp.inf))
