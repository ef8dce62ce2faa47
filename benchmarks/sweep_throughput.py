"""Sweep throughput beside its peers in one run: `python -m benchmarks.sweep_throughput`.

An axis-step is one 1 ms tick of one axis: sensor with noise and quantiser, observer, MPC move, damping,
delay, tissue, metrics. The floor is about 100 floating-point operations of it on some 14 numbers of state.
"""

import argparse
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.terminal.process import use_all_cores

CONTROLLERS, PEER_BATCHES, PEER_SECONDS = 8192, (1024, 2048, 4096, 8192), 1.0


def machine() -> str:
    """Processor and number of cores, as the system names them."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.exists() else []
    name = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), platform.machine())
    return f"{name}, {len(os.sched_getaffinity(0))} cores"


def fastest(function: Callable[[], Any], repeats: int = 3) -> float:
    """Least wall time of a few calls [s]: on a shared machine the others only measure the neighbours."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def main() -> None:
    """Measure and print; every peer is first shown to compute the same."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--controllers", type=int, default=CONTROLLERS)
    rows = parser.parse_args().controllers
    use_all_cores()
    import jax
    import msgspec

    from benchmarks.peers import dlsim_residual, numpy_loop
    from jaxmpc import Experiment, Params, evaluate
    from jaxmpc.closed_loops import close_loops, evaluate_block
    from jaxmpc.engine.base import scalars
    from jaxmpc.engine.scenario import program_spec, scenario_data
    from jaxmpc.xla.blocks import OverBlocks

    experiment = Experiment.published("table-1")
    scene, world = scenario_data(experiment), program_spec(experiment)
    cells = 3 * len(experiment.stiffness)
    batch = Params().with_columns({"Q_p": np.geomspace(0.1, 1.0, rows), "Khat_s": np.linspace(800.0, 1000.0, rows)})

    def apart(p: Params) -> Any:
        gains, _, contacts, *_ = close_loops(p, scene.stiffness, scene.path)
        return scalars(gains, False), contacts

    peers = jax.tree.map(np.asarray, jax.jit(apart)(batch))
    brief = msgspec.structs.replace(experiment, duration=4.0, settle=3.0)
    found = evaluate(batch[:8], brief).metrics[:-1]
    loop = numpy_loop(*first_rows(peers, 8), scenario_data(brief), np.float64)
    off = max(
        float(np.max(np.abs(np.moveaxis(a, -1, 0) - b) / np.maximum(b, 1e-9))) for a, b in zip(loop, found, strict=True)
    )
    quiet = msgspec.structs.replace(brief, sensor=msgspec.structs.replace(brief.sensor, lsb=(0.0, 0.0, 0.0)))
    gains, contact = one_cell(peers)
    lone = (
        dlsim_residual(gains, contact, scenario_data(quiet), 2) / evaluate(batch[:8], quiet).metrics.rms[0, 1, 2] - 1.0
    )
    print(f"{machine()}; jax {jax.__version__}, {jax.local_device_count()} devices; {experiment.steps} steps")
    print(
        f"same results in float64: numpy loop, all metrics, to {off:.0e}; dlsim, without quantiser, to {abs(lone):.0e}"
    )

    engine = OverBlocks(lambda p, s: evaluate_block(p, s, world=world, dtype="float32"))
    began = time.perf_counter()
    engine(batch, scene)
    compiled = time.perf_counter() - began
    ours = rows * cells * experiment.steps / fastest(lambda: engine(batch, scene))
    line(f"sweep engine: design, margins, float32 loop ({compiled:.0f} s first)", ours)
    loop_only = OverBlocks(lambda p, s: evaluate_block(p, s, world=world, dtype="float32").metrics)
    loop_only(batch, scene)
    bare = rows * cells * experiment.steps / fastest(lambda: loop_only(batch, scene))
    line("  its loop alone (what the peers do)", bare)
    best = 0.0
    for dtype in (np.float32, np.float64):
        for size in PEER_BATCHES:
            rate = numpy_rate(numpy_loop, first_rows(peers, size), scene, dtype, cells * min(size, rows))
            best = max(best, rate)
            line(f"numpy loop over time, batch {size}, {np.dtype(dtype).name}", rate)
    single = experiment.steps / fastest(lambda: dlsim_residual(gains, contact, scene, 2))
    line("one controller at a time, scipy.signal.dlsim", single)
    print(f"ratios, with margins: {ours / best:.1f} × the best numpy loop, {ours / single:.0f} × one at a time")
    print(f"ratios, like with like: {bare / best:.1f} × the best numpy loop, {bare / single:.0f} × one at a time")


def line(name: str, rate: float) -> None:
    """One row of the result."""
    print(f"{name:58} {rate / 1e6:9.2f} M axis-steps/s", flush=True)


def first_rows(tree: Any, rows: int) -> Any:
    """The first controllers of a batch of gains and worlds."""
    import jax

    return jax.tree.map(lambda leaf: leaf[:rows], tree)


def one_cell(peers: Any) -> Any:
    """The first controller on its second tissue."""
    import jax

    gains, contacts = peers
    return jax.tree.map(lambda leaf: leaf[0], gains), jax.tree.map(lambda leaf: leaf[0, 1], contacts)


def numpy_rate(loop: Callable[..., Any], cut: Any, scene: Any, dtype: Any, lanes: int) -> float:
    """Axis-steps per second of the numpy loop, over as many steps as take about a second."""
    import jax

    steps = 200

    def cut_time(n: int) -> Any:
        return scene._replace(signals=jax.tree.map(lambda signal: signal[:, :n], scene.signals))

    probe = fastest(lambda: loop(*cut, cut_time(steps), dtype), 1)
    steps = int(np.clip(steps * PEER_SECONDS / probe, steps, scene.signals.score.shape[1]))
    return lanes * steps / fastest(lambda: loop(*cut, cut_time(steps), dtype))


if __name__ == "__main__":
    main()
