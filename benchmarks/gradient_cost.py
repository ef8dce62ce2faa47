"""What a gradient costs, arm in the loop: all scalar parameters, and full diagonals, against one simulation.

    python -m benchmarks.gradient_cost

The floor of reverse mode with one checkpoint per step is four simulations: forward, forward again, and backward, which
counts two. Design and margins come on top of both and are in all figures.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.terminal.process import use_all_cores
from tuning import TuneSpec
from tuning.objective.loss import value_alone
from tuning.objective.problem import Problem, problem_of, training

STARTS, RUNS = 16, 3


def job(diagonals: list[str]) -> TuneSpec:
    """Three scenarios on three tissues, two seconds each."""
    free = {name: True for name in ("lam", "delta", "Q_p", "Q_x", "T_cl", "K2", "Khat_s", "Hp", "Hu")}
    return TuneSpec.from_dict(
        {
            "experiment": {"published": "table-1-wam", "reference": {"z": []}},
            "scenarios": {"friction": 0.3, "mass": 0.1},
            "tune": {
                "starts": STARTS,
                "train_seeds": [0, 1, 2],
                "duration": 2.0,
                "settle": 0.5,
                "margin_points": 9,
                "free": free,
                "diagonals": diagonals,
            },
        }
    )


def seconds(function: Callable[[], Any]) -> float:
    """The best of some runs, compilation not counted."""
    function()
    found = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        function()
        found.append(time.perf_counter() - begin)
    return min(found)


def forward(problem: Problem, z: np.ndarray) -> Callable[[], Any]:
    """The same look without its gradient, dealt out to the devices in the same way."""
    from jax.sharding import Mesh, PartitionSpec

    spec: Any = PartitionSpec
    mesh = Mesh(np.array(jax.local_devices()), ("device",))
    data = problem.data._replace(margins={})
    limits = jax.tree.map(lambda limit: jnp.broadcast_to(limit, (len(z),)), problem.data.margins)

    def on_device(rows: Any, data: Any) -> Any:
        return value_alone(rows[0], data._replace(margins=rows[1]), 1.0, problem.structure).loss

    specs = (spec("device"), spec())
    mapped = jax.shard_map(on_device, mesh=mesh, in_specs=specs, out_specs=spec("device"), check_vma=False)
    compiled = jax.jit(mapped)
    return lambda: np.asarray(compiled((z, limits), data))


def main() -> None:
    """Measure and print."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    use_all_cores()
    times = {}
    for name, diagonals in (("scalars", []), ("diagonals", ["lam", "delta"])):
        spec = job(diagonals)
        problem = problem_of(spec, training(spec, spec.tune.train_seeds))
        z = np.tile(spec.space.encode(spec.params), (STARTS, 1))
        if not diagonals:
            times["simulation"] = seconds(forward(problem, z))
        times[name] = seconds(partial(problem.differentiate, z, 1.0))
        print(f"{name}: {spec.space.size} parameters")
    for name, value in times.items():
        print(f"{name:<12} {value:8.3f} s   {value / times['simulation']:5.2f} x one simulation")
    print(f"diagonals over scalars {times['diagonals'] / times['scalars']:.2f}")


if __name__ == "__main__":
    main()
