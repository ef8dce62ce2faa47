"""One tick of the frozen arm controller without the bus, beside its peers: `python -m benchmarks.robot_tick`.

A tick is velocity filter → three cascades → computed torque → what was applied, told to the observers. Peers, in the
same run and in turns of a thousand: the same law on Python floats, not recorded; and inverse dynamics by C MuJoCo with
the rest in numpy, as one writes it without this package, and without a guard. All read the same inputs. "floor" is a
chain of as many products and sums as `control` has, and nothing else: no state, no names, no function. "elapsed" is
what the wall clock says, "own" what of it the processor spent on the tick: they differ where others use the machine.
Then a million ticks, to see what stays behind.
"""

import argparse
import gc
import math
import sys
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import mujoco_loop
from deploy.controller.file import load
from deploy.controller.golden import arm_inputs
from deploy.controller.runtimes import arm_runtime, flown_controller
from deploy.runtime.straightline import compile_straightline
from jaxmpc.law import force_control
from jaxmpc.law.gains import constant_reference
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.reference import split
from tests.deploy import made

Rows = list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]]
MEDIAN, P99 = 60.0, 150.0
"""Bars of the recorded tick [µs]."""


def recorded(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    runtime = arm_runtime(artifact)
    runtime.start(rows[0][0])
    runtime.enter(rows[0][1], rows[0][0])

    def tick(k: int) -> Any:
        q, force, wanted = rows[k]
        torque = runtime.control(q, runtime.velocity(q), force, wanted)
        runtime.applied((torque[0], torque[1] - 1e-3, torque[2], torque[3]))
        return torque

    return tick


def on_floats(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    controller, compensated = flown_controller(artifact)
    state = force_control.init(controller, *rows[0][:2], compensated)

    def tick(k: int) -> Any:
        nonlocal state
        q, force, wanted = rows[k]
        told = wanted if artifact.preview else tuple((w,) for w in wanted)
        present, ahead = split(told, len(controller.gains.mpc_ref))
        state, command = force_control.step(controller, state, q, force, ahead, FLOATS, present=present)
        torque = command.torque.torque
        state = force_control.applied(state, command, (torque[0], torque[1] - 1e-3, torque[2], torque[3]))
        return torque

    return tick


def by_mujoco(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    import mujoco

    arm, gains = artifact.arm, constant_reference(artifact.gains)
    loop = mujoco_loop.Loop(mass_scale=arm.nominal.mass_scale, tool_mass_error=arm.nominal.tool_error)
    nominal = mujoco_loop.NominalArm(mujoco.MjModel.from_xml_path(str(mujoco_loop.WAM)), loop)
    cascades = mujoco_loop.Cascade(mujoco_loop.Gains.of(gains, artifact.K2))
    cascades.state[0] = cascades.state[5] = rows[0][1]
    pole, posture = math.exp(-artifact.loop.velocity_cutoff * artifact.T_s), np.array(arm.posture)
    weights = np.array(artifact.gains.mpc_ref) / sum(artifact.gains.mpc_ref)
    inputs = [tuple(map(np.array, row)) for row in rows]
    last, velocity = inputs[0][0], np.zeros(4)

    def tick(k: int) -> Any:
        nonlocal last, velocity
        q, force, wanted = inputs[k]
        if artifact.preview:  # the constant that weighs as much as what is known ahead
            wanted = wanted[:, 1:] @ weights
        raw = (q - last) / artifact.T_s
        last, velocity = q, raw + pole * (velocity - raw)
        v = cascades.step(force, wanted)
        J, drift, M, bias = nominal.update(q, velocity)
        a = v - artifact.K2 * (J @ velocity)
        rest = -20.0 * (q - posture) - 9.0 * velocity
        response = np.linalg.solve(M, J.T)
        at_the_tip = np.linalg.solve(J @ response, a - drift - J @ rest) + force
        torque = M @ rest + bias + J.T @ at_the_tip
        cascades.v += response.T @ np.array([0.0, -1e-3, 0.0, 0.0])
        return torque

    return tick


def floor(operations: int) -> Callable[[int], Any]:
    def chain(x: Any) -> Any:
        for _ in range(operations // 2):
            x = 0.5 * x + 1.0
        return x

    return compile_straightline(chain, (0.0,)).function


def times(ticks: dict[str, Callable[[int], Any]], rounds: int, n: int) -> dict[str, np.ndarray]:
    """Elapsed and own time of each tick (2, ticks) [µs], in turns so that all meet the same machine."""
    took: dict[str, list[tuple[int, int]]] = {name: [] for name in ticks}
    for _ in range(rounds):
        for name, tick in ticks.items():
            for i in range(1000):
                own, began = time.thread_time_ns(), time.perf_counter_ns()
                tick(i % n)
                ended = time.perf_counter_ns()
                took[name].append((ended - began, time.thread_time_ns() - own))
    return {name: 1e-3 * np.array(rows).T for name, rows in took.items()}


def left_behind(tick: Callable[[int], Any], count: int, n: int) -> str:
    """What a long run leaves, with the collector on as it is by default."""
    gc.collect()
    for k in range(2000):
        tick(k % n)
    collections, blocks = [stage["collections"] for stage in gc.get_stats()], sys.getallocatedblocks()
    began = time.perf_counter()
    for k in range(count):
        tick(k % n)
    took = time.perf_counter() - began
    more = sys.getallocatedblocks() - blocks
    again = [stage["collections"] for stage in gc.get_stats()]
    ran = sum(now - before for now, before in zip(again, collections, strict=True))
    tracemalloc.start()
    for k in range(200):
        tick(k % n)
    traced, _ = tracemalloc.get_traced_memory()
    for k in range(2000):
        tick(k % n)
    grown = tracemalloc.get_traced_memory()[0] - traced
    tracemalloc.stop()
    text = f"{count} ticks in {took:.1f} s: {ran} collections, {more:+d} memory blocks; "
    return text + f"traced memory {grown:+d} bytes over 2000 ticks"


def main() -> int:
    """Print the table; 1 if the recorded tick misses its bars."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--artifact", help="a controller for the arm (one of plain numbers)")
    parser.add_argument("--ticks", type=int, default=1_000_000)
    args = parser.parse_args()
    artifact = load(args.artifact) if args.artifact else made.arm_artifact(500)
    rows: Rows = [tuple(map(tuple, row)) for row in arm_inputs(artifact)]
    makers = {"recorded": recorded, "law on floats": on_floats, "MuJoCo and numpy": by_mujoco}
    torques = {
        name: np.array([tick(k) for tick in [make(artifact, rows)] for k in range(100)])
        for name, make in makers.items()
    }
    apart = {name: float(np.max(np.abs(torque - torques["recorded"]))) for name, torque in torques.items()}
    ticks = {name: make(artifact, rows) for name, make in makers.items()}
    operations = arm_runtime(artifact).operations
    ticks["floor"] = floor(operations)
    found = times(ticks, 20, len(rows))
    print(f"{operations} operations; Python {sys.version.split()[0]}")
    print(" " * 18 + "  elapsed: median      p99   own: median      p99  [µs]   torque beside the recorded [N m]")
    for name, took in found.items():
        elapsed, own = np.percentile(took, (50.0, 99.0), axis=1).T
        beside = f"{apart[name]:.1e}" if name in apart else "–"
        print(f"{name:<18}{elapsed[0]:>17.1f} {elapsed[1]:>8.1f}{own[0]:>14.1f} {own[1]:>8.1f}         {beside}")
    print(left_behind(recorded(artifact, rows), args.ticks, len(rows)))
    median, p99 = np.percentile(found["recorded"][0], (50.0, 99.0))
    return int(median > MEDIAN or p99 > P99)


if __name__ == "__main__":
    sys.exit(main())
