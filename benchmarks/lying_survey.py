"""A sample of how far a lying force sensor makes the robot press: words, signs, tissues, references, moments, pairs.

    python -m benchmarks.lying_survey controller.npz --flights 2000 --jobs 16 --output survey.jsonl

Each flight is drawn by its number alone, so a survey that was interrupted goes on where it stopped, and parts that were
flown apart (`--first`) are one survey once their files are joined; `--flights 0` only reports. A flight takes some 2 s.
"""

import argparse
import json
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.lying_sensor import GAP, HELD, RATE, contact_of, fly
from deploy.controller.file import load
from jaxmpc.world.tissue import KINDS

WORDS: dict[str, tuple[float, ...]] = {
    "off": (),
    "stuck": (),
    "garbage": (),
    "sign": (),
    "wrong": (1.0, 2.0, 5.0),
    "jump": (4.0, 10.0),
    "unit": (0.05, 0.2, 0.5, 2.0, 5.0),
    "slow": (5.0, 10.0, 50.0),
    "delayed": (5.0, 20.0, 50.0, 100.0),
    "intermittent": (0.1, 0.3, 0.7),
}
"""Words of a force sensor and the sizes of their values."""
SIGNED = ("wrong", "jump", "unit")
PAIRS = (
    *("positions:lost=0.02", "frames:lost=0.01", "commands:lost=0.02", "frames:late=1@{at}+0.05", "J2:off@{at}+0.01"),
    *("force:intermittent=0.05", "force:wrong=2@{at}", "force:delayed=5"),
)
"""What befalls besides; {at} is a moment near that of the word."""
STIFFNESSES, REFERENCES = (375.0, 600.0, 810.0, 1300.0, 1900.0), (-2.0, -5.0, -10.0)
PHASES = ("approach", "ramp", "contact", "retract")
RETRACTING = 0.6
"""A retraction of 30 mm takes that long [s]."""
MUCH = 1.2
"""Share of the largest wanted push, a family's sine in it, beyond which no fault, once it has set in, may press and end
`finished`."""


class Case(NamedTuple):
    """A flight to be flown; `share` of its phase has gone when the word sets in."""

    word: str
    fault: str
    phase: str
    share: float
    tissue: str
    stiffness: float
    wanted: float
    pair: str


def drawn(seed: int, number: int) -> Case:
    """The case of a number: words and phases in turn, the rest at random."""
    dice = np.random.default_rng((seed, number))
    word = list(WORDS)[number % len(WORDS)]
    fault = word
    if WORDS[word]:
        size = float(dice.choice(WORDS[word])) * (float(dice.choice((-1.0, 1.0))) if word in SIGNED else 1.0)
        fault = f"{word}={size:g}"
    return Case(
        word,
        fault,
        PHASES[number // len(WORDS) % len(PHASES)],
        float(dice.random()),
        str(dice.choice(KINDS)),
        float(dice.choice(STIFFNESSES)),
        float(dice.choice(REFERENCES)),
        str(dice.choice(PAIRS)) if number // (len(WORDS) * len(PHASES)) % 2 else "",
    )


class Cell(NamedTuple):
    """A tissue; each is met once without a fault, to learn when."""

    tissue: str
    stiffness: float


class Survey:
    """Flights of one controller in processes of their own."""

    def __init__(self, path: Path, seed: int, jobs: int) -> None:
        """Start the processes."""
        self._seed, self._chunk = seed, 4 * jobs
        self._pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin, (path,))

    def contacts(self, cells: set[Cell]) -> dict[Cell, float]:
        """When tissues are met [s]."""
        those = sorted(cells)
        return dict(zip(those, self._pool.map(_contact, those), strict=True))

    def rows(self, numbers: list[int], contacts: dict[Cell, float], until: float) -> Iterator[dict[str, Any]]:
        """Flights of some numbers in their order, none begun after a time of the monotonic clock [s]."""
        for first in range(0, len(numbers), self._chunk):
            if time.monotonic() > until:
                return
            these = numbers[first : first + self._chunk]
            cases = [drawn(self._seed, number) for number in these]
            at = [contacts[Cell(case.tissue, case.stiffness)] for case in cases]
            yield from self._pool.map(_row, these, cases, at, [self._seed] * len(these))


_artifact: Any = None
"""Controller of a process that flies."""


def _begin(path: Path) -> None:
    global _artifact
    _artifact = load(path)


def _contact(cell: Cell) -> float:
    return contact_of(_artifact, cell.stiffness, cell.tissue)


def _row(number: int, case: Case, contact: float, seed: int) -> dict[str, Any]:
    flown = fly(_artifact, faults_of(case, contact), case.stiffness, case.tissue, case.wanted, seed=seed + number)
    came = {
        "contact": contact,
        "push": round(flown.push, 4),
        "since": round(flown.since, 4),
        "wanted_peak": round(flown.wanted_peak, 4),
        "reason": str(flown.reason),
    }
    return {"number": number, **case._asdict(), **came}


def faults_of(case: Case, contact: float) -> tuple[str, ...]:
    """The faults of a case, in the twin's words, where the tissue is met at a time [s]."""
    pressed = contact + abs(case.wanted) / RATE
    end = pressed + 2.0 * HELD  # see `fly`
    begin, over = {
        "approach": (contact - GAP / 0.005, contact),
        "ramp": (contact, pressed),
        "contact": (pressed, end),
        "retract": (end, end + RETRACTING),
    }[case.phase]
    at = begin + case.share * (over - begin)
    pair = case.pair.format(at=f"{max(at - 0.02, 0.0):.3f}")
    return (f"force:{case.fault}@{at:.3f}", *((pair,) if pair else ()))


def report(rows: list[dict[str, Any]], limit: float) -> int:
    """Print the worst of each word; how many flights went beyond the limit or ended `finished` having pressed much."""
    print(f"{len(rows)} flights, limit {limit:g} N; largest true push on the tissue")
    bad = 0
    for word in WORDS:
        mine = [row for row in rows if row["word"] == word]
        if not mine:
            continue
        beyond = [row for row in mine if row["push"] > limit]
        unseen = [row for row in mine if row["reason"] == "finished" and row["since"] > MUCH * row["wanted_peak"]]
        bad += len(beyond) + len(unseen)
        print(f"  {word:<13}{len(mine):>5} flights, {len(beyond)} beyond the limit, {len(unseen)} unseen")
        alone = [row for row in mine if not row["pair"]]
        for title, those in (("alone", alone), ("worst", mine), ("unseen", unseen)):
            if those:
                row = max(those, key=lambda each: float(each["push"]))
                print(f"    {title:<7}{row['push']:6.2f} N  {row['fault']} {_where(row)}: {row['reason']}")
    return bad


def _where(row: dict[str, Any]) -> str:
    pair = f", with {row['pair']}" if row["pair"] else ""
    phase = f"{100.0 * row['share']:.0f} % into {row['phase']}"
    return f"{phase}, {row['tissue']} {row['stiffness']:g} N/m, {row['wanted']:g} N{pair}, number {row['number']}"


def main() -> int:
    """Fly what is missing, then report; 1 if a flight passed the limit, or went unnoticed having pressed much."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("artifact", type=Path)
    parser.add_argument("--flights", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="number of the first (0)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes that fly (1)")
    parser.add_argument("--output", type=Path, required=True, help="a line of JSON a flight; what is there is kept")
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="stop after so long; the same command goes on from there"
    )
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes: threads of numpy would only wait for each other
    arm, until = load(args.artifact).arm, time.monotonic() + 60.0 * args.minutes
    assert arm is not None
    lines = args.output.read_text().splitlines() if args.output.exists() else []
    rows = {row["number"]: row for row in map(json.loads, lines)}
    missing = [number for number in range(args.first, args.first + args.flights) if number not in rows]
    if missing:
        survey = Survey(args.artifact, args.seed, args.jobs)
        known = {Cell(row["tissue"], row["stiffness"]): row["contact"] for row in rows.values()}
        cases = [drawn(args.seed, number) for number in missing]
        known |= survey.contacts({Cell(case.tissue, case.stiffness) for case in cases} - set(known))
        with args.output.open("a") as out:
            for row in survey.rows(missing, known, until):
                rows[row["number"]] = row
                print(json.dumps(row), file=out, flush=True)
                if sys.stderr.isatty():
                    print(f"\r{len(rows)} flights", end="", file=sys.stderr)
    return int(report(list(rows.values()), arm.limits.force) > 0)


if __name__ == "__main__":
    sys.exit(main())
