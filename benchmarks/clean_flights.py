"""How near healthy flights come to what ends a flight whose sensor lies: rhythms, tissues, stiffnesses, arms.

    python -m benchmarks.clean_flights controller.npz --flights 450 --jobs 16 --output clean.jsonl

Every rhythm on every tissue and stiffness in turn, each fourth on an arm with twice the friction and a tenth more mass.
A flight takes some 3 s; the same command goes on where it stopped. Exit code 1 after a false alarm.
"""

import argparse
import json
import math
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.lying_sensor import GAP, RATE
from benchmarks.lying_survey import STIFFNESSES
from deploy.controller.file import load
from deploy.controller.limits import ROWS
from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.safety.force_balance import HIDDEN, PUSH
from deploy.safety.late_force import LATE
from deploy.safety.machine import OperatingState
from deploy.safety.plausible import FORCE_JUMP, STUCK
from deploy.safety.runaway import ASKED
from deploy.safety.unmoved import shares
from deploy.twin.flight import Pilot, started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.scenario import HEARTS, RHYTHMS, SCENARIOS, twin_settings
from deploy.twin.twin import Twin
from jaxmpc.world.tissue import KINDS

HELD = 4.0
"""Time in contact besides the ramp [s]."""
ARMS: tuple[dict[str, Any], ...] = ({}, {}, {}, {"coulomb": (4.0, 4.5, 2.2, 1.3), "mass_scale": 1.1})
CASES = tuple(product((-2.0, -5.0), (HEARTS[0], *RHYTHMS, *SCENARIOS), KINDS, STIFFNESSES))
BOUNDS = {
    "hidden": HIDDEN,
    "push": PUSH,
    "asked": ASKED,
    "jump": FORCE_JUMP,
    "late": LATE,
    "overshoot": ROWS["overshoot"].default,
    "unmoved": 1.0,
}
"""What a flight is ended at: push that friction does not explain [N], push beyond the air's [N], acceleration asked of
the tip [m/s²], change of the force from one sample to the next [N], its lag [s], measured push over the wanted [-], and
what pushes a motor that stands still on the way out over what it bears [-]."""


def flown(path: Path, number: int) -> dict[str, Any]:
    """A healthy flight: how it ended, and the largest of each quantity in contact."""
    artifact = load(path)
    wanted, rhythm, tissue, stiffness = CASES[number % len(CASES)]
    arm = ARMS[number % len(ARMS)]
    twin = Twin(twin_settings(stiffness=stiffness, tissue=tissue, rhythm=rhythm, gap=GAP, seed=number, **arm))
    clock = LockstepClock(twin)
    session, bus = started(artifact, clock, f"0,0,{wanted:g}@{RATE:g}", RATE, seconds=1.0)
    pilot, most, last = Pilot(session, twin, abs(wanted) / RATE + HELD), dict.fromkeys(BOUNDS, 0.0), [None]

    def each(result: CycleResult) -> OperatorCommand:
        balance, force = session.cycle.watch.balance, result.force
        if result.safety_state.state is OperatingState.CONTACT:
            seen = {"hidden": balance.hidden, "push": balance.push - balance.air}
            seen["asked"] = math.hypot(*session.controller.runtime.last_a)
            seen["late"] = min(session.controller.runtime.lag)
            if force is not None and last[0] is not None:
                seen["jump"] = max(abs(new - old) for new, old in zip(force, last[0], strict=True))
            most.update({name: max(most[name], value) for name, value in seen.items()})
        elif result.safety_state.state in (OperatingState.RETRACT, OperatingState.STOPPED) and force is not None:
            watch, still = session.cycle.watch, session.cycle.positions.still
            pushed = zip(still, shares(watch.disturbance, watch.read), strict=True)
            most["unmoved"] = max(most["unmoved"], *(share for samples, share in pushed if samples >= STUCK - 1), 0.0)
        last[0] = force  # type: ignore[call-overload]  # None at first
        return pilot(result)

    ended = session.run(OperatorCommand(True, True), None, each)
    bus.close()
    pushes = session.cycle.pushes
    most["overshoot"] = pushes.measured / max(pushes.wanted, abs(wanted))
    case = {"number": number, "wanted": wanted, "rhythm": rhythm, "tissue": tissue, "stiffness": stiffness}
    return {**case, "heavy": bool(arm), "reason": str(ended.safety_state.reason), **most}


def report(rows: list[dict[str, Any]]) -> int:
    """Print the largest of each quantity beside its bound; the number of false alarms."""
    alarms = [row for row in rows if row["reason"] != "finished"]
    print(f"{len(rows)} healthy flights, {len(alarms)} ended by an alarm")
    for row in alarms:
        print(f"  {row}")
    for name, bound in BOUNDS.items():
        for heavy in (False, True):
            mine = [row for row in rows if row["heavy"] is heavy and row not in alarms]
            if mine:
                worst = max(mine, key=lambda row: float(row[name]))
                where = f"{worst['rhythm']}, {worst['tissue']} {worst['stiffness']:g} N/m, {worst['wanted']:g} N"
                print(f"  {name:<10}{'heavy' if heavy else 'usual':<6} {worst[name]:8.4f} of {bound:g}: {where}")
    return len(alarms)


def main() -> int:
    """Fly what is missing, then report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("artifact", type=Path)
    parser.add_argument("--flights", type=int, default=len(CASES))
    parser.add_argument("--first", type=int, default=0, help="number of the first (0)")
    parser.add_argument(
        "--step",
        type=int,
        default=1,
        help="fly each so many-th: 7 is a sample of all, an even one leaves the heavy arm out (1)",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes that fly (1)")
    parser.add_argument("--output", type=Path, required=True, help="a line of JSON a flight; what is there is kept")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes: threads of numpy would only wait for each other
    lines = args.output.read_text().splitlines() if args.output.exists() else []
    rows = {row["number"]: row for row in map(json.loads, lines)}
    numbers = range(args.first, args.first + args.flights * args.step, args.step)
    missing = [number for number in numbers if number not in rows]
    with (
        ProcessPoolExecutor(args.jobs, multiprocessing.get_context("spawn")) as pool,
        args.output.open("a") as out,
    ):
        for row in pool.map(flown, [args.artifact] * len(missing), missing):
            rows[row["number"]] = row
            print(json.dumps(row), file=out, flush=True)
    return int(report(list(rows.values())) > 0)


if __name__ == "__main__":
    sys.exit(main())
