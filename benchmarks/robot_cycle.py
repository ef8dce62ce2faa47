"""A cycle of the robot's loop without the bus: `python -m benchmarks.robot_cycle`, a minute in lock-step with the twin.

A cycle is plausibility → state machine → law → clamp → frame → checker, from what the bus brought to the frame that may
be sent. Beside it, what the loop does around it, and the recorded law alone. Times of the processor are this thread's.
"""

import argparse
import gc
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from deploy.bus.bus import Bus
from deploy.controller.file import load
from deploy.loop.cycle import OperatorCommand
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.reference.segments import from_words
from deploy.twin.flight import Pilot
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from jaxmpc.world.heart.motion import Motion
from tests.deploy import made

MEDIAN, P99 = 80.0, 200.0
"""Bars [µs]."""


class Timed:
    """A function, and how long each of its calls took: elapsed and on this thread's processor [ns]."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.took: list[tuple[int, int]] = []

    def __call__(self, *arguments: Any) -> Any:
        own, began = time.thread_time_ns(), time.perf_counter_ns()
        result = self.function(*arguments)
        self.took.append((time.perf_counter_ns() - began, time.thread_time_ns() - own))
        return result


def main() -> int:
    """Print the table; 1 if the cycle misses the bars of a tick."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--artifact", help="a controller for the arm (one of plain numbers)")
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    twin = Twin(TwinSettings(gap=0.012, motion=Motion(start=3.5), frame="tool"))
    clock = LockstepClock(twin)
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=True, tare=False)
    artifact = load(args.artifact) if args.artifact else made.arm_artifact()
    session = Session(artifact, Bus(LockstepBus(clock), clock.now), clock, options, lambda sentence: None)
    parts = {
        "ask and collect": session.arm.collect,
        "cycle": session.cycle.step,
        "law": session.controller.runtime.control,
        "checker": session.cycle.checker.check,
        "recorder": session.recorder.append,
    }
    timed = {name: Timed(function) for name, function in parts.items()}
    owners = (session.arm, session.cycle, session.controller.runtime, session.cycle.checker, session.recorder)
    for (name, function), owner in zip(parts.items(), owners, strict=True):
        setattr(owner, function.__name__, timed[name])

    gc.collect()
    gc.freeze()
    gc.disable()
    ended = session.run(OperatorCommand(True, True), None, Pilot(session, twin, args.seconds))
    gc.enable()
    print(f"{ended.safety_state.state}, {ended.safety_state.reason}; {ended.contact_cycles} cycles in contact")
    print(" " * 18 + "  elapsed: median      p99   own: median      p99  [µs]")
    for name, part in timed.items():
        rows = 1e-3 * np.array(part.took[-ended.contact_cycles :])
        elapsed, own = np.percentile(rows, (50.0, 99.0), axis=0).T
        print(f"{name:<18}{elapsed[0]:>17.1f} {elapsed[1]:>8.1f}{own[0]:>14.1f} {own[1]:>8.1f}")
    cycle = 1e-3 * np.array(timed["cycle"].took[-ended.contact_cycles :])[:, 0]
    median, p99 = np.percentile(cycle, (50.0, 99.0))
    return int(median > MEDIAN or p99 > P99)


if __name__ == "__main__":
    sys.exit(main())
