"""What comes of an encoder that sticks or tells late from a random moment on: why the flight ends, and how fast.

    python -m benchmarks.encoder_faults controller.npz --flights 40
    python -m benchmarks.encoder_faults controller.npz --word delayed=40

A joint or motor of the four, a moment from the approach to the retraction, a force, a tissue; a flight takes some 2 s.
Exit code 1 where a joint came to more than 1.5 rad/s; beyond 2 the safety module lets the arm go.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from deploy.controller.file import load
from deploy.loop.cycle import OperatorCommand
from deploy.twin.flight import Pilot, started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.scenario import twin_settings
from deploy.twin.twin import Twin

GAP, RATE, HELD = 0.008, 20.0, 4.0
"""Distance to the tissue at the start [m], rate of the wanted force [N/s], time in contact [s]."""
MOMENTS = 0.3, 6.3
"""The fault begins between these times of the twin [s]; the tip withdraws at some 5."""
FAST = 1.5
"""[rad/s]"""


def main() -> int:
    """Fly, and tell of each flight and of the fastest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("artifact", type=Path)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--word", default="stuck", help="the fault, as the twin takes it (stuck)")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    artifact, random, fastest = load(args.artifact), np.random.default_rng(args.seed), 0.0
    for _ in range(args.flights):
        motor, at = int(random.integers(1, 5)), round(float(random.uniform(*MOMENTS)), 3)
        wanted, stiffness = random.choice([-2, -5, -10]), float(random.choice([375.0, 810.0, 1900.0]))
        tissue, fault = str(random.choice(["elastic", "fung", "hunt-crossley"])), f"J{motor}:{args.word}@{at}"
        speeds = np.zeros(4)

        def watch(now: Twin, speeds: np.ndarray = speeds) -> None:
            np.maximum(speeds, np.abs(now.truth().qd), out=speeds)

        twin = Twin(twin_settings(stiffness=stiffness, tissue=tissue, gap=GAP, faults=(fault,)))
        clock = LockstepClock(twin, watch)
        session, bus = started(artifact, clock, f"0,0,{wanted}@4", RATE, tare=False, seconds=1.0)
        ended = session.run(OperatorCommand(True, True), None, Pilot(session, twin, HELD))
        bus.close()
        fastest = max(fastest, speeds.max())
        said = " ".join(f"{speed:.2f}" for speed in speeds)
        print(f"{fault:<20} {wanted:>3} N {stiffness:6g} N/m {tissue:<13} {ended.safety_state.reason:<14} {said} rad/s")
    print(f"fastest joint of {args.flights} flights: {fastest:.2f} rad/s")
    return int(fastest > FAST)


if __name__ == "__main__":
    sys.exit(main())
