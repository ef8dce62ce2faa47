"""How far a lying force sensor makes the robot press: flights in lock-step, the worst true push per fault word.

    python -m benchmarks.lying_sensor controller.npz --tissues elastic,fung --stiffness 1300,1900 --references=-5,-10

Each word sets in before the approach, at contact or in contact at the wanted force, alone or with lost positions.
"""

import argparse
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from deploy.controller.file import load
from deploy.errors import CalibrationError
from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.flight import Pilot, started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.peak_force import PeakForces
from deploy.twin.scenario import twin_settings
from deploy.twin.twin import Twin

WORDS = (
    *("unit=0.2", "unit=-0.2", "unit=0.5", "unit=0.02", "unit=5", "sign", "delayed=100", "delayed=20", "slow=20"),
    *("wrong=2", "wrong=-2", "wrong=5", "jump=10", "jump=-10", "stuck", "garbage", "intermittent=0.3", "off"),
)
PHASES = ("before", "contact", "wanted")
GAP, RATE, HELD = 0.012, 5.0, 1.0
"""Way to the tissue [m], rate of the wanted force [N/s], time at the wanted force [s]."""


class Flown(NamedTuple):
    """What came of a flight."""

    push: float
    """Largest true push on the tissue [N]."""
    since: float
    """The same since the first fault set in [N]."""
    wanted_peak: float
    """Largest push that was wanted in contact, the sine of a family in it [N]; 0 if contact never was."""
    reason: Reason
    state: OperatingState


def fly(artifact: Any, faults: tuple[str, ...], stiffness: float, tissue: str, wanted: float, **settings: Any) -> Flown:
    """One flight with faults, timed from the twin's beginning."""
    twin = Twin(twin_settings(stiffness=stiffness, tissue=tissue, gap=GAP, faults=faults, **settings))
    peaks, since = PeakForces(), PeakForces()
    begin = min((fault.start for fault in twin.faults), default=0.0)

    def watch(now: Twin) -> None:
        force = now.truth().force
        peaks.add_true(force)
        if now.now >= begin:
            since.add_true(force)

    clock = LockstepClock(twin, watch)
    try:
        session, bus = started(artifact, clock, f"0,0,{wanted:g}@{RATE:g}", RATE, seconds=1.0)
    except CalibrationError:  # the tare has seen it
        return Flown(peaks.true_push, since.true_push, 0.0, Reason.NOT_STARTED, OperatingState.IDLE)
    pilot = Pilot(session, twin, abs(wanted) / RATE + 2.0 * HELD)
    ended = session.run(OperatorCommand(True, True), None, pilot)
    bus.close()
    wanted_peak = session.cycle.pushes.wanted
    return Flown(peaks.true_push, since.true_push, wanted_peak, ended.safety_state.reason, ended.safety_state.state)


def contact_of(artifact: Any, stiffness: float, tissue: str) -> float:
    """When a clean flight makes contact [s]."""
    twin = Twin(twin_settings(stiffness=stiffness, tissue=tissue, gap=GAP))
    clock = LockstepClock(twin)
    session, bus = started(artifact, clock, f"0,0,-5@{RATE:g}", RATE, seconds=1.0)
    pilot, contact = Pilot(session, twin, 0.1), []

    def each(result: CycleResult) -> OperatorCommand:
        if result.safety_state.state is OperatingState.CONTACT:
            contact.append(twin.now)
        return pilot(result)

    session.run(OperatorCommand(True, True), None, each)
    bus.close()
    return contact[0]


def moments(contact: float, wanted: float) -> dict[str, float]:
    """When faults set in, by phase [s].

    Args:
        contact: When contact is made [s]; for what sets in before, any number.
        wanted: Force [N].
    """
    return {"before": 0.15, "contact": contact + 0.02, "wanted": contact + abs(wanted) / RATE + HELD}


def flights(artifact: Any, args: argparse.Namespace) -> Iterator[tuple[str, str, bool, str, float, float, Flown]]:
    """All of them."""
    for tissue, stiffness in product(args.tissues, args.stiffness):
        contact = contact_of(artifact, stiffness, tissue)
        lossies = (False, True) if args.lossy else (False,)
        for wanted, word, phase, lossy in product(args.references, args.words, args.phases, lossies):
            times = moments(contact, wanted)
            faults = (f"force:{word}@{times[phase]:.3f}", *(("positions:lost=0.02",) if lossy else ()))
            yield word, phase, lossy, tissue, stiffness, wanted, fly(artifact, faults, stiffness, tissue, wanted)


def main() -> int:
    """Print the table; 1 if a flight passed the limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words, numbers = (lambda text: text.split(",")), (lambda text: [float(each) for each in text.split(",")])
    parser.add_argument("artifact", type=Path)
    parser.add_argument("--words", type=words, default=list(WORDS))
    parser.add_argument("--phases", type=words, default=list(PHASES))
    parser.add_argument("--tissues", type=words, default=["elastic", "fung"])
    parser.add_argument("--stiffness", type=numbers, default=[1300.0, 1900.0])
    parser.add_argument("--references", type=numbers, default=[-5.0, -10.0])
    parser.add_argument("--lossy", action="store_true", help="each also with every fiftieth position lost")
    args = parser.parse_args()
    artifact = load(args.artifact)
    assert artifact.arm is not None
    worst: dict[str, tuple[float, str]] = {}
    finished: dict[str, float] = {}
    count = 0
    for word, phase, lossy, tissue, stiffness, wanted, flown in flights(artifact, args):
        count += 1
        case = (
            f"{phase}, {tissue}, {stiffness:g} N/m, {wanted:g} N{', lost positions' if lossy else ''}: {flown.reason}"
        )
        worst[word] = max(worst.get(word, (0.0, "")), (flown.push, case))
        if flown.reason is Reason.FINISHED:
            finished[word] = max(finished.get(word, 0.0), flown.push / flown.wanted_peak)
    print(f"{count} flights, limit {artifact.arm.limits.force:g} N; largest true push per word")
    for word, (push, case) in worst.items():
        unseen = f"; unseen at most {finished[word]:.2f} of the wanted force" if word in finished else ""
        print(f"  {word:<16} {push:6.2f} N  {case}{unseen}", flush=True)
    return int(max(push for push, _ in worst.values()) > artifact.arm.limits.force)


if __name__ == "__main__":
    sys.exit(main())
