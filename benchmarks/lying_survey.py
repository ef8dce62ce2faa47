"""A sample of how far a lying force sensor makes the robot press: words, signs, tissues, references, moments, pairs.

    python -m benchmarks.lying_survey controller.npz --flights 2000 --output survey.jsonl

Each flight is drawn by its number alone, so a survey that was interrupted goes on where it stopped, and two parts that
were flown apart are one survey. A flight takes some 2 s.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.lying_sensor import GAP, HELD, RATE, Flown, fly, moments
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
"""Share of the wanted force beyond which nobody may press and end `finished`."""


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


class Survey:
    """Flights of one controller, and when each tissue is met."""

    def __init__(self, artifact: Any, rows: list[dict[str, Any]]) -> None:
        """Take the controller and what was flown before: each tissue is met once without a fault to learn when."""
        self._artifact = artifact
        self._contacts = {(row["tissue"], row["stiffness"]): float(row["contact"]) for row in rows}

    def contact(self, case: Case) -> float:
        """When the tissue of a case is met [s]."""
        key = case.tissue, case.stiffness
        if key not in self._contacts:
            self._contacts[key] = moments(self._artifact, case.stiffness, case.tissue, -2.0)["contact"] - 0.02
        return self._contacts[key]

    def flown(self, case: Case, seed: int) -> Flown:
        """One flight."""
        contact = self.contact(case)
        pressed = contact + abs(case.wanted) / RATE
        end = pressed + 2.0 * HELD  # see `fly`
        begin, over = {
            "approach": (contact - GAP / 0.005, contact),
            "ramp": (contact, pressed),
            "contact": (pressed, end),
            "retract": (end, end + RETRACTING),
        }[case.phase]
        at = begin + case.share * (over - begin)
        faults = [f"force:{case.fault}@{at:.3f}"]
        if case.pair:
            faults.append(case.pair.format(at=f"{max(at - 0.02, 0.0):.3f}"))
        return fly(self._artifact, tuple(faults), case.stiffness, case.tissue, case.wanted, seed=seed)


def report(rows: list[dict[str, Any]], limit: float) -> int:
    """Print the worst of each word; how many flights went beyond the limit or ended `finished` having pressed much."""
    print(f"{len(rows)} flights, limit {limit:g} N; largest true push on the tissue")
    bad = 0
    for word in WORDS:
        mine = [row for row in rows if row["word"] == word]
        if not mine:
            continue
        beyond = [row for row in mine if row["push"] > limit]
        unseen = [row for row in mine if row["reason"] == "finished" and row["push"] > MUCH * abs(row["wanted"])]
        bad += len(beyond) + len(unseen)
        print(f"  {word:<13}{len(mine):>5} flights, {len(beyond)} beyond the limit, {len(unseen)} unseen")
        for title, those in (("worst", mine), ("unseen", unseen)):
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
    parser.add_argument("--output", type=Path, required=True, help="a line of JSON a flight; what is there is kept")
    parser.add_argument("--minutes", type=float, help="stop after so long; the same command goes on from there")
    args = parser.parse_args()
    artifact = load(args.artifact)
    assert artifact.arm is not None
    lines = args.output.read_text().splitlines() if args.output.exists() else []
    rows = [json.loads(line) for line in lines]
    survey, began = Survey(artifact, rows), time.monotonic()
    done = {row["number"] for row in rows}
    with args.output.open("a") as out:
        for number in range(args.first, args.first + args.flights):
            if number in done:
                continue
            if args.minutes is not None and time.monotonic() - began > 60.0 * args.minutes:
                break
            case = drawn(args.seed, number)
            flown = survey.flown(case, args.seed + number)
            came = {"contact": survey.contact(case), "push": flown.push, "reason": str(flown.reason)}
            rows.append({"number": number, **case._asdict(), **came})
            print(json.dumps(rows[-1]), file=out, flush=True)
            if sys.stderr.isatty():
                print(f"\r{len(rows)} of {args.flights} flights", end="", file=sys.stderr)
    return int(report(rows, artifact.arm.limits.force) > 0)


if __name__ == "__main__":
    sys.exit(main())
