"""Closed-loop steps per second on the arm, beside its peers, in one run: `python -m benchmarks.arm_throughput`.

A closed-loop step is one sample of everything: arm, friction, tissue, noise, quantisers, three cascades, computed
torque on a second model, metrics. Floor: some 2 200 arithmetic operations a step.
"""

import argparse
import multiprocessing
import os
import time
from typing import Any

# One thread each: the Python loop and the CasADi processes shall not fight over cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.sweep_throughput import fastest, machine
from jaxmpc.terminal.process import use_all_cores

SECONDS = 4.0
BLOCKS = (256, 512, 1024)


def main() -> None:
    """Measure and print; every peer is first shown to compute the same."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", type=int, nargs="*", default=BLOCKS, help="controllers in a block")
    blocks = parser.parse_args().blocks
    use_all_cores()
    import jax
    import msgspec

    from jaxmpc import Experiment, Params, evaluate

    experiment = msgspec.structs.replace(
        Experiment.published("table-1-wam"), stiffness=(810.0,), duration=SECONDS, settle=3.0
    )
    residual = np.asarray(evaluate(Params.published("text"), experiment).metrics.rms)[0]
    print(f"{machine()}; jax {jax.__version__}, {jax.local_device_count()} devices; {experiment.steps} steps")
    ours: dict[tuple[str, str], float] = {}
    for physics, dtype, sizes in (
        ("wam", "float32", blocks),
        ("wam", "float64", blocks),
        ("mjx", "float32", blocks[:1]),
    ):
        for size in sizes:
            rate, compiled = engine_rate(msgspec.structs.replace(experiment, physics=physics), dtype, size)
            line(f"{physics}, {dtype}, blocks of {size} ({compiled:.0f} s first)", rate)
            ours[physics, dtype] = max(rate, ours.get((physics, dtype), 0.0))
    python, found = python_loop(experiment)
    check("Python loop", found, residual, 1e-2)  # it steps by Euler, the engine by leapfrog
    line("Python loop, C MuJoCo and numpy controller, one core", python)
    best = ours["wam", "float32"]
    for dtype in ("float64", "float32"):
        casadi, found = casadi_rate(dtype)
        check(f"CasADi {dtype}", found, residual, 1e-2 if dtype == "float32" else 1e-9)
        line(f"CasADi, whole-episode C, gcc -O3, {dtype}, a process per core", casadi)
        print(f"  ratio wam {dtype} / CasADi {dtype}: {ours['wam', dtype] / casadi:.2f}")
    print(f"ratio wam / mjx, float32: {best / ours['mjx', 'float32']:.1f}")
    print(f"ratio wam float32 / Python loop: {best / python:.0f}")


def line(name: str, rate: float) -> None:
    """One row of the result."""
    print(f"{name:66} {rate / 1e6:9.4f} M steps/s", flush=True)


def check(name: str, found: np.ndarray, residual: np.ndarray, tolerance: float) -> None:
    """Refuse a peer that computes something else."""
    off = float(np.max(np.abs(found / residual - 1.0)))
    if not off < tolerance:
        raise SystemExit(f"{name} has another residual: {found} instead of {residual}")
    print(f"  {name}: same residual to {off:.0e}")


def engine_rate(experiment: Any, dtype: str, size: int) -> tuple[float, float]:
    """Steps per second on all devices, and seconds of the first call."""
    import jax

    from jaxmpc import Params
    from jaxmpc.closed_loops import close_loops
    from jaxmpc.engine.registry import choose
    from jaxmpc.engine.scenario import program_spec, scenario_data
    from jaxmpc.xla.blocks import OverBlocks

    rows = size * jax.local_device_count()
    scene, world = scenario_data(experiment), program_spec(experiment)
    params = Params().with_columns({"Q_p": np.geomspace(0.3, 0.6, rows), "Khat_s": np.linspace(850.0, 950.0, rows)})

    def apart(p: Params) -> Any:
        gains, K2, contacts, *_ = close_loops(p, scene.stiffness, scene.path)
        return gains, K2, contacts

    batch = jax.tree.map(np.asarray, jax.jit(apart)(params))

    engine = OverBlocks(lambda b, s: choose(world).simulate(world, *b, s, dtype).metrics.rms, size)
    began = time.perf_counter()
    engine(batch, scene)
    compiled = time.perf_counter() - began
    return rows * experiment.steps / fastest(lambda: engine(batch, scene)), compiled


def python_loop(experiment: Any) -> tuple[float, np.ndarray]:
    """Steps per second of one environment in a Python loop, and its residual RMS [N]."""
    from benchmarks import mujoco_loop
    from jaxmpc import Params, design
    from jaxmpc.world.heart.motion import displacement

    params = Params.published("text")
    gains = mujoco_loop.Gains.of(design(params), float(params.K2))
    t = np.arange(experiment.steps) * experiment.sampling_time
    heart, velocity = displacement(experiment.motion, t)
    _, noise, wanted, score = experiment.signals
    loop = mujoco_loop.Loop(stiffness=810.0, coulomb=experiment.arm.coulomb)
    records: list[Any] = []

    def once() -> None:
        records[:] = [mujoco_loop.run(loop, gains, heart, velocity, noise, wanted)]

    rate = experiment.steps / fastest(once)
    return rate, mujoco_loop.residual(records[0], wanted, score)[1]


def casadi_rate(dtype: str) -> tuple[float, np.ndarray]:
    """Steps per second of one process per core, each running one environment, and the residual RMS [N]."""
    cores = len(os.sched_getaffinity(0))
    context = multiprocessing.get_context("spawn")
    with context.Pool(cores) as pool:
        results = pool.map(_casadi_worker, [dtype] * cores)
    return sum(rate for rate, _ in results), results[0][1]


def _casadi_worker(dtype: str) -> tuple[float, np.ndarray]:
    use_all_cores()
    import jax
    import msgspec

    from benchmarks.casadi_episode import Episode
    from jaxmpc import Experiment, Params, design
    from jaxmpc.engine.base import scalars
    from jaxmpc.engine.scenario import program_spec, scenario_data

    experiment = msgspec.structs.replace(
        Experiment.published("table-1-wam"), stiffness=(810.0,), duration=SECONDS, settle=3.0
    )
    params = Params.published("text")
    gains = jax.tree.map(float, scalars(jax.tree.map(np.asarray, design(params)), False))
    episode = Episode(program_spec(experiment), scenario_data(experiment), gains, float(params.K2), 810.0, dtype)
    residual = episode.run()
    return experiment.steps / fastest(episode.run, 20), residual


if __name__ == "__main__":
    main()
