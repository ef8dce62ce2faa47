"""Sweep throughput beside its peers in one run: `python -m benchmarks.sweep_throughput`.

An axis-step is one 1 ms tick of one axis: sensor with noise and quantiser, observer, MPC move, damping,
delay, tissue, metrics. The floor is about 100 floating-point operations of it on some 14 numbers of state.

Like with like are the engine's loop alone and the numpy loop: both are handed gains and tissues that were computed
before, meet the same samples, gather the same metrics, in float32 and warm, on every core. Only the length differs: the
numpy loop runs as many steps as take a second, of which as many are scored as of all. scipy.signal.dlsim, on every core
as well, does less: one axis in float64, no quantiser, no metric but the residual's RMS; its matrices it makes itself.
Times are of the wall: where others use the machine the engine, whose calls are longer, loses more.
"""

import argparse
import multiprocessing
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.terminal.process import use_all_cores

CONTROLLERS, PEER_BATCHES, PEER_SECONDS, PROBED = 8192, (1024, 2048, 4096, 8192), 1.0, 200


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
    from jaxmpc.closed_loops import close_loops, evaluate_block, run_loops
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
    loops = jax.tree.map(np.asarray, jax.jit(lambda p: close_loops(p, scene.stiffness, scene.path))(batch))
    loop_only = OverBlocks(lambda each, s: run_loops(each, s, world=world, dtype="float32").metrics)
    loop_only(loops, scene)
    bare = rows * cells * experiment.steps / fastest(lambda: loop_only(loops, scene))
    line("  its loop alone (what the peers do)", bare)
    best = 0.0
    for dtype in (np.float32, np.float64):
        for size in [size for size in PEER_BATCHES if size <= rows] or [rows]:
            rate = on_every_core(numpy_rate, numpy_loop, first_rows(peers, size), scene, dtype, cells * size)
            best = max(best, rate)
            line(f"numpy loop over time, batch {size} a core, {np.dtype(dtype).name}", rate)
    single = on_every_core(dlsim_rate, dlsim_residual, gains, contact, scene)
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


def on_every_core(rate: Callable[..., float], *arguments: Any) -> float:
    """Sum of what processes, one a core, tell of themselves while all are at work."""
    cores = len(os.sched_getaffinity(0))
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        return sum(pool.starmap(rate, [arguments] * cores, 1))


def dlsim_rate(residual: Callable[..., float], gains: Any, contact: Any, scene: Any) -> float:
    """Axis-steps per second of one controller on one tissue and axis at a time."""
    return scene.signals.score.shape[1] / fastest(lambda: residual(gains, contact, scene, 2))


def numpy_rate(loop: Callable[..., Any], cut: Any, scene: Any, dtype: Any, lanes: int) -> float:
    """Axis-steps per second of the numpy loop, over as many steps as take about a second."""
    probe = fastest(lambda: loop(*cut, stretch(scene, PROBED), dtype), 1)
    part = stretch(scene, int(PROBED * max(PEER_SECONDS / probe, 1.0)))
    return lanes * part.signals.score.shape[1] / fastest(lambda: loop(*cut, part, dtype))


def stretch(scene: Any, steps: int) -> Any:
    """So many steps of a scene at most, of which the same share is scored as of all: masked ones cost the peer less."""
    import jax

    score = np.asarray(scene.signals.score).any(axis=0)
    steps = min(steps, len(score))
    first = round(int(np.argmax(score)) * (1.0 - steps / len(score)))
    return scene._replace(signals=jax.tree.map(lambda signal: signal[:, first : first + steps], scene.signals))


if __name__ == "__main__":
    main()
