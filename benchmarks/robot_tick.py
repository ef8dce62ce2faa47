"""One tick of the frozen arm controller without the bus, beside what it would cost otherwise: `python -m benchmarks.robot_tick`.

A tick is velocity filter → three cascades → computed torque → what was applied, told to the observers. Peers, in the
same run and turn by turn: the same law on Python floats, not recorded; and inverse dynamics by C MuJoCo with the rest in
numpy, as one writes it without this package. All read the same inputs. Then a million ticks, to see what stays behind.
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
from deploy.arm_runtime import ArmRuntime
from deploy.artifact import load
from jaxmpc.law import cascade, force_control
from jaxmpc.law.scalar import scale, sub
from tests.deploy import made

Rows = list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]]
MEDIAN, P99 = 80.0, 200.0
"""Bars of the recorded tick [µs]."""


def recorded(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    runtime = ArmRuntime(artifact)
    runtime.start(rows[0][0])
    runtime.enter(rows[0][1], rows[0][0])

    def tick(k: int) -> Any:
        q, force, wanted = rows[k]
        torque = runtime.control(q, runtime.velocity(q), force, wanted)
        runtime.applied((torque[0], torque[1] - 1e-3, torque[2], torque[3]))
        return torque

    return tick


def on_floats(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    arm, gains = artifact.arm, cascade.constant_reference(artifact.gains)
    pole = math.exp(-arm.velocity_cutoff * artifact.T_s)
    state = force_control.State(tuple(cascade.init(y, cascade.order(gains)) for y in rows[0][1]), None)
    last, velocity = rows[0][0], (0.0,) * 4

    def tick(k: int) -> Any:
        nonlocal state, last, velocity
        q, force, wanted = rows[k]
        raw = scale(1.0 / artifact.T_s, sub(q, last))
        last, velocity = q, tuple(new + pole * (old - new) for new, old in zip(raw, velocity, strict=True))
        state, command = force_control.step(
            arm.chain,
            arm.nominal,
            arm.posture,
            gains,
            artifact.K2,
            state,
            q,
            velocity,
            force,
            tuple((w,) for w in wanted),
            math,
        )
        torque = command.torque.torque
        state = force_control.applied(state, command, (torque[0], torque[1] - 1e-3, torque[2], torque[3]))
        return torque

    return tick


def by_mujoco(artifact: Any, rows: Rows) -> Callable[[int], Any]:
    import mujoco

    arm, gains = artifact.arm, cascade.constant_reference(artifact.gains)
    loop = mujoco_loop.Loop(mass_scale=arm.nominal.mass_scale, tool_mass_error=arm.nominal.tool_error)
    nominal = mujoco_loop.NominalArm(mujoco.MjModel.from_xml_path(str(mujoco_loop.WAM)), loop)
    cascades = mujoco_loop.Cascade(mujoco_loop.Gains(*gains, K2=artifact.K2))
    cascades.state[0] = cascades.state[5] = rows[0][1]
    pole, posture = math.exp(-arm.velocity_cutoff * artifact.T_s), np.array(arm.posture)
    inputs = [tuple(map(np.array, row)) for row in rows]
    last, velocity = inputs[0][0], np.zeros(4)

    def tick(k: int) -> Any:
        nonlocal last, velocity
        q, force, wanted = inputs[k]
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


def times(ticks: dict[str, Callable[[int], Any]], count: int, n: int) -> dict[str, np.ndarray]:
    """Each tick's times [µs], turn by turn so that all meet the same machine."""
    took: dict[str, np.ndarray] = {name: np.empty(count) for name in ticks}
    for i in range(count):
        for name, tick in ticks.items():
            began = time.perf_counter_ns()
            tick(i % n)
            took[name][i] = 1e-3 * (time.perf_counter_ns() - began)
    return took


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
    for k in range(2000):
        tick(k % n)
    traced, _ = tracemalloc.get_traced_memory()
    for k in range(20_000):
        tick(k % n)
    grown = tracemalloc.get_traced_memory()[0] - traced
    tracemalloc.stop()
    text = f"{count} ticks in {took:.1f} s: {ran} collections, {more:+d} memory blocks; "
    return text + f"traced memory {grown:+d} bytes over 20000 ticks"


def main() -> int:
    """Print the table; 1 if the recorded tick misses its bars."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--artifact", help="a controller for the arm (one of plain numbers)")
    parser.add_argument("--ticks", type=int, default=1_000_000)
    args = parser.parse_args()
    artifact = load(args.artifact) if args.artifact else made.arm_artifact(500)
    arrays = (artifact.arm.golden_q, artifact.golden_force, artifact.golden_force_ref)
    rows: Rows = [tuple(map(tuple, row)) for row in zip(*(array.tolist() for array in arrays), strict=True)]
    makers = {"recorded": recorded, "law on floats": on_floats, "MuJoCo and numpy": by_mujoco}
    torques = {
        name: np.array([tick(k) for tick in [make(artifact, rows)] for k in range(100)])
        for name, make in makers.items()
    }
    apart = {name: float(np.max(np.abs(torque - torques["recorded"]))) for name, torque in torques.items()}
    ticks = {name: make(artifact, rows) for name, make in makers.items()}
    found = times(ticks, 20_000, len(rows))
    print(f"{ArmRuntime(artifact).operations} operations; Python {sys.version.split()[0]}")
    print("                    median      p99   p99.9   [µs]   torque beside the recorded [N m]")
    for name, took in found.items():
        median, p99, p999 = np.percentile(took, (50.0, 99.0, 99.9))
        print(f"{name:<18} {median:>7.1f}  {p99:>7.1f} {p999:>7.1f}          {apart[name]:.1e}")
    print(left_behind(recorded(artifact, rows), args.ticks, len(rows)))
    median, p99 = np.percentile(found["recorded"], (50.0, 99.0))
    return int(median > MEDIAN or p99 > P99)


if __name__ == "__main__":
    sys.exit(main())
