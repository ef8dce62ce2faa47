"""The tuner's objective without its gradient, for any controller that the cascade's law can express.

The benchmark refuses to start unless both give the same number.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array

from benchmarks.rivals import pi
from jaxmpc.closed_loops import ClosedLoops, close_loops
from jaxmpc.stability.loop import contacts_of
from tuning.job.space import SearchSpace
from tuning.objective.evaluated import judge, run
from tuning.objective.measures import Data, ProblemStructure
from tuning.objective.problem import Problem

BATCH = 16
"""Controllers at a time: fewer take as long, more are no faster each (measured)."""
Law = Callable[[Array, Data, ProblemStructure], ClosedLoops]
"""The loops that unconstrained vectors (rows, size) stand for."""
LOST = 1e3
"""Loss of a controller whose runs left the finite numbers [-]."""


class ObjectiveValues(NamedTuple):
    """What the objective says of controllers, each (controllers,)."""

    loss: Any
    """log risk and penalties [-]."""
    score: Any
    """Risk of the soft goals [-]; NaN where unstable."""
    hard: Any
    """Largest normalised hard goal [-]; met at 1 and below."""


def evaluator(problem: Problem, law: Law, rows: int = BATCH) -> Callable[[np.ndarray], ObjectiveValues]:
    """The objective of any number of unconstrained vectors (n, size), so many at a time on all devices.

    Args:
        problem: The tuner's problem by runs.
        law: What a vector stands for: `mpc_aob` or `pi_control`.
        rows: How many at a time.
    """
    program, devices = _program(problem.structure, law)
    rows = -(-rows // devices) * devices

    def evaluate(z: np.ndarray) -> ObjectiveValues:
        parts = []
        for first in range(0, len(z), rows):
            part = z[np.minimum(np.arange(first, first + rows), len(z) - 1)]
            parts.append(jax.tree.map(np.asarray, program(part, problem.data)))
        found: ObjectiveValues = jax.tree.map(lambda *fields: np.concatenate(fields)[: len(z)], *parts)
        return found._replace(loss=np.nan_to_num(found.loss, nan=LOST, posinf=LOST))

    return evaluate


@cache
def _program(structure: ProblemStructure, law: Law) -> tuple[Callable[..., ObjectiveValues], int]:
    """Compiled once per structure and law, and on how many devices it runs."""
    spec: Any = PartitionSpec

    def on_device(z: Array, data: Data) -> ObjectiveValues:
        return judged(law(z, data, structure), data, structure)

    mesh = Mesh(np.array(jax.local_devices()), ("device",))
    split = spec("device")
    mapped = jax.shard_map(on_device, mesh=mesh, in_specs=(split, spec()), out_specs=split, check_vma=False)
    program: Callable[..., ObjectiveValues] = jax.jit(mapped)
    return program, mesh.size


def mpc_aob(z: Array, data: Data, structure: ProblemStructure) -> ClosedLoops:
    """The tuner's own controller; traceable."""
    space = SearchSpace(data.base, structure.axes)
    params = jax.vmap(lambda vector: space.decode(vector, 1.0))(z)
    return close_loops(params, data.scene.stiffness, data.scene.path)


def pi_control(z: Array, data: Data, structure: ProblemStructure) -> ClosedLoops:
    """The PI controller with damping, in the same worlds and judged at the same margins; traceable."""
    found = jax.vmap(pi.decode)(z)
    gains = jax.vmap(lambda one: pi.gains(one, data.scene.path.T_s))(found)
    contacts = contacts_of(found.K2, data.scene.stiffness, data.scene.path)
    return ClosedLoops(gains, found.K2, contacts, jnp.zeros_like(found.K2))


def judged(loops: ClosedLoops, data: Data, structure: ProblemStructure) -> ObjectiveValues:
    """Loss of closed loops, as the tuner has it; traceable."""
    margins = judge(loops, data)
    runs = run(loops, margins.stable, data, structure)
    hard = jnp.max(jnp.concatenate([margins.worst, runs.worst], axis=1), axis=1, initial=0.0)
    return ObjectiveValues(margins.loss + runs.loss, jnp.where(margins.stable, runs.risk, jnp.nan), hard)
