"""Loader and `check` against re-sealed artifacts: a valid seal around wrong content, a million times.

    python -m benchmarks.artifact_fuzz --inputs 1000000 --jobs 16 --minutes 60 --output fuzz.jsonl

Counts inputs, refusals, exceptions and the longest processor time (nothing here waits); of what is accepted, what is
changed in it and whether that is absurd: another law than the file's, a limit or a place that no arm has.
Each input is drawn by its number alone, and each block of a thousand is a line of the output: the same command goes on
where it stopped, and the lines of several machines are one result once joined.
"""

import argparse
import contextlib
import io
import json
import math
import multiprocessing
import os
import sys
import tempfile
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from deploy.cli import check
from deploy.controller import golden, recomputed_margins
from deploy.controller.arm_model import GOLDEN, KNOWN
from deploy.controller.artifact import Artifact
from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from deploy.controller.limits import MECHANICAL_STOPS, REACH
from deploy.controller.recomputed_margins import margins_at
from deploy.controller.runtimes import arm_runtime, flown_controller
from deploy.loop.session import HEART, deepest
from deploy.runtime.arm import ArmRuntime
from jaxmpc.files.sealed import SEAL, seal, unseal
from tests.deploy import made

WORDS: tuple[Any, ...] = (None, True, "inf", "nan", "", "1", [], {}, [[]], [1.0] * 7, {"a": 1}, 10**400, "\ud800x"[1:])
NUMBERS = (0, -0.0, -1.0, 1.0, 5e-324, 1e-320, 1e-12, 1e12, 1.7e308, -1e308, 2**53, 0.5, 3)
FACTORS = (-1.0, 0.0, 1e-6, 0.5, 0.999, 1.0 + 1e-6, 1.001, 2.0, 10.0, 1e3, 1e6)
SAME = 1e-6
"""Torque by which a law that is the file's own may differ in a run it has never seen [N m]; its golden trace is
replayed to 1e-9 and is 40 times shorter than what forgets nothing."""
DEEP = REACH + HEART
"""Farthest that a tip may be allowed to go down in tissue [m]."""
BLOCK = 1000
"""Inputs of a line of the output."""
DULL = ("provenance", "params")
"""Tables in which nothing but words and notes can be changed: most of the time goes elsewhere."""


def changed(dice: np.random.Generator, table: Any, path: tuple[str, ...] = ()) -> tuple[Any, str, Any]:
    """A table with one entry changed at some depth, the entry's path and its new value."""
    if isinstance(table, dict | list) and table and dice.random() < 0.95:
        keys = list(table) if isinstance(table, dict) else list(range(len(table)))
        key = keys[dice.integers(len(keys))]
        if key in DULL and dice.random() < 0.9:
            key = keys[dice.integers(len(keys))]
        if dice.random() < 0.03:
            is_table = isinstance(table, dict)
            kept = {k: v for k, v in table.items() if k != key} if is_table else table[:key] + table[key + 1 :]
            return kept, "/".join((*path, str(key), "-")), None
        if isinstance(table, dict) and dice.random() < 0.03:
            return {**table, str(dice.integers(9)): table[key]}, "/".join((*path, "+")), None
        inner, where, value = changed(dice, table[key], (*path, str(key) if isinstance(table, dict) else "#"))
        if isinstance(table, list):
            return [inner if i == key else each for i, each in enumerate(table)], where, value
        return {**table, key: inner}, where, value
    kind = dice.integers(3)
    new: Any = WORDS[dice.integers(len(WORDS))]
    if kind == 1:
        new = NUMBERS[dice.integers(len(NUMBERS))]
    if kind == 2 and isinstance(table, int | float):
        with contextlib.suppress(OverflowError):
            new = table * FACTORS[dice.integers(len(FACTORS))]
    if isinstance(new, float) and not math.isfinite(new):
        new = "inf"
    return new, "/".join(path), new


def changed_arrays(dice: np.random.Generator, arrays: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], str]:
    """One array changed, left out, doubled, or of another type or shape."""
    name = list(arrays)[dice.integers(len(arrays))]
    value = arrays[name]
    place = tuple(dice.integers(length) for length in value.shape)
    one = value.copy()
    one[place] = (np.nan, np.inf, -one[place], one[place] * 1.001, 1e300, 5e-324)[dice.integers(6)]
    odd = (
        *(value[:, 0], value * np.nan, value.astype(str), np.full(value.shape, 1e300), value.astype("<f4"), value[:0]),
        *(value.astype(">f8"), value.astype(complex), value[::-1], np.zeros((0, 10**6, 3)), np.float64(1.0), value.T),
        *(np.asfortranarray(value), value[None], value.astype(bool), np.zeros((), "V8"), one, one, one, one, one, one),
    )
    kind = int(dice.integers(len(odd) + 2))
    if kind == len(odd):
        return {key: each for key, each in arrays.items() if key != name}, f"{name} left out"
    if kind == len(odd) + 1:
        return arrays | {f"{name}{dice.integers(9)}": value}, f"{name} twice"
    return arrays | {name: np.asarray(odd[kind])}, f"{name} {kind}"


def forged(dice: np.random.Generator, data: bytes, header: dict[str, Any], arrays: Any) -> tuple[bytes, str]:
    """A file with a valid seal and wrong content, and what was changed in it."""
    kind = dice.random()
    if kind < 0.7:
        with contextlib.suppress(TypeError, ValueError, UnicodeEncodeError):
            table, where, value = changed(dice, header)
            if dice.random() < 0.2:
                table, also, _ = changed(dice, table)
                where = f"{where} {also}"
            return seal(table, arrays), f"{where} = {value!r:.40}"
    if kind < 0.85:
        with contextlib.suppress(TypeError, ValueError):
            odd, where = changed_arrays(dice, arrays)
            return seal(header, odd), where
    body = bytearray(data[:-SEAL])
    for _ in range(dice.integers(1, 5)):
        body[dice.integers(len(body))] ^= int(dice.integers(1, 256))
    return bytes(body) + sha256(body).digest(), "bytes"


def torques(artifact: Artifact) -> np.ndarray:
    """What it asks of the arm in a run that it has never seen, shape (40, 4) [N m]."""
    runtime, (qs, forces, wanted) = arm_runtime(artifact), made.recorded_inputs(40, seed=5)
    runtime.start(qs[0])
    runtime.enter(forces[0], qs[0])
    rows = zip(qs, forces, wanted, strict=True)
    return np.array([runtime.control(q, runtime.velocity(q), y, [axis[0] for axis in ref]) for q, y, ref in rows])


def law(artifact: Artifact) -> str:
    """All that its torques depend on."""
    arm = None if artifact.arm is None else {k: v for k, v in vars(artifact.arm).items() if k not in (*GOLDEN, *KNOWN)}
    return exact((artifact.gains, artifact.T_s, artifact.K2, artifact.preview, artifact.loop, arm))


def exact(value: Any) -> str:
    """A value to its last digit: the text of gains and parameters, made for people, rounds."""
    if isinstance(value, np.ndarray):
        return exact(value.tolist())
    if isinstance(value, tuple | list):
        return f"({', '.join(map(exact, value))})"
    if isinstance(value, dict):
        return f"({', '.join(f'{key}: {exact(each)}' for key, each in value.items())})"
    return exact(vars(value)) if hasattr(value, "__dict__") else repr(value)


def absurd(artifact: Artifact, good: Artifact, expected: np.ndarray) -> str:
    """What no arm, no tissue or not this law can have; empty if nothing."""
    arm = artifact.arm
    if arm is None:
        return "" if artifact.kind == "linear" else "no arm"
    found = expected if law(artifact) == law(good) else torques(artifact)
    if not np.allclose(found, expected, rtol=0.0, atol=SAME):
        return f"another law: {np.max(np.abs(found - expected)):.2g} N m"
    if not 0.0 < deepest(artifact) < DEEP:
        return f"may press {deepest(artifact):.2g} m deep"
    stops = zip(arm.posture, MECHANICAL_STOPS, strict=True)
    if not all(low <= angle <= high for angle, (low, high) in stops):
        return f"stands at {arm.posture}"
    if not 0.0 < arm.tool_length < REACH:
        return f"a tip {arm.tool_length} m beyond the elbow"
    limits = arm.limits
    if not (limits.force <= 100.0 and limits.tip_velocity <= 1.0 and max(limits.joint_torque) <= 101.7):
        return f"limits {limits}"
    return ""


class Attack:
    """A process's attacks on one good controller."""

    def __init__(self, seed: int) -> None:
        """Make it, and leave out what is no parsing: twenty thousand steps that are timed, margins known already."""
        good = made.arm_artifact(12)
        rows = [margins_at(good, row["stiffness"]) for row in good.margins]
        self.good = Artifact(**{**vars(good), "margins": rows, "floor": {"M_s": 5.0}})
        self.data, self.expected, self.seed = to_bytes(self.good), torques(self.good), seed
        header, self.arrays = unseal(self.data)
        self.header = json.loads(json.dumps(header))
        remember_margins()
        remember_runtimes()
        check._times = lambda artifact, count=0: [0.0] * 100

    def block(self, first: int) -> dict[str, Any]:
        """What came of a block of inputs, from a number on."""
        counts = {name: Counter[str]() for name in ("tally", "refusals", "passed", "strange")}
        longest = 0.0
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            for number in range(first, first + BLOCK):
                longest = max(longest, self._one(number, Path(folder) / "controller.npz", counts))
        return {"first": first, "longest": longest, **counts}

    def _one(self, number: int, path: Path, counts: dict[str, Counter[str]]) -> float:
        """Attack with an input; the processor time that it took [s]."""
        tally, strange = counts["tally"], counts["strange"]
        content, what = forged(np.random.default_rng((self.seed, number)), self.data, self.header, self.arrays)
        if content == self.data:
            tally["the same"] += 1
            return 0.0
        tally["inputs"] += 1
        start = time.process_time()
        try:
            found = from_bytes(content)
        except ArtifactError as error:
            counts["refusals"][str(error)[:24]] += 1
            return time.process_time() - start
        except Exception as error:
            strange[f"{type(error).__name__}: {error} at {what}, number {number}"] += 1
            return time.process_time() - start
        tally["accepted by the loader"] += 1
        path.write_bytes(content)
        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = check.run(Namespace(artifact=path, require_signature=None))
            taken = time.process_time() - start
            wrong = absurd(found, self.good, self.expected)
        except Exception as error:
            strange[f"{type(error).__name__}: {error} at {what}, number {number}"] += 1
            return time.process_time() - start
        tally["refused by check" if code else "accepted by both"] += 1
        if wrong:
            where = "by both" if code == 0 else "by the loader alone"
            strange[f"absurd, accepted {where}: {wrong} at {what}, number {number}"] += 1
        if code == 0:
            counts["passed"][what.partition(" = ")[0]] += 1
        return taken


_attack: Attack
"""That of a process."""


def _begin(seed: int) -> None:
    global _attack
    _attack = Attack(seed)


def _block(first: int) -> dict[str, Any]:
    return _attack.block(first)


def report(blocks: Iterable[dict[str, Any]]) -> int:
    """Print what came of all blocks; 1 after an exception, a hang or something absurd."""
    tally, refusals, passed, strange = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    longest = 0.0
    for block in blocks:
        for counter, name in ((tally, "tally"), (refusals, "refusals"), (passed, "passed"), (strange, "strange")):
            counter.update(block[name])
        longest = max(longest, block["longest"])
    print(", ".join(f"{key} {count}" for key, count in tally.items()))
    print(f"refused by the loader {refusals.total()}, for {len(refusals)} reasons; longest time {1e3 * longest:.0f} ms")
    print("accepted by both: " + ", ".join(f"{what} {count}" for what, count in passed.most_common(40)))
    print(f"exceptions and absurdities: {strange.total()}")
    print("".join(f"  {count} × {what}\n" for what, count in strange.most_common(40)), end="")
    return int(strange.total() > 0 or longest > 1.0)


def main() -> int:
    """Attack with what is missing, then report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--first", type=int, default=0, help=f"number of the first, a multiple of {BLOCK} (0)")
    parser.add_argument("--jobs", type=int, default=1, help="processes that attack (1)")
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after so long; the same command goes on")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, required=True, help="a line of JSON a block; what is there is kept")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes: threads of numpy would only wait for each other
    until = time.monotonic() + 60.0 * args.minutes
    lines = args.output.read_text().splitlines() if args.output.exists() else []
    blocks = {block["first"]: block for block in map(json.loads, lines)}
    missing = [first for first in range(args.first, args.first + args.inputs, BLOCK) if first not in blocks]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(args.jobs, spawn, _begin, (args.seed,)) as pool, args.output.open("a") as out:
        for at in range(0, len(missing), args.jobs):
            if time.monotonic() > until:
                break
            for block in pool.map(_block, missing[at : at + args.jobs]):
                blocks[block["first"]] = block
                print(json.dumps(block), file=out, flush=True)
    return report(blocks.values())


def remember_margins() -> None:
    """Compute margins once for each loop: most inputs leave the loop as it is, and a row takes 0.1 s."""
    known: dict[tuple[Any, ...], dict[str, float]] = {}

    def remembered(artifact: Artifact, stiffness: float) -> dict[str, float]:
        key = exact(artifact.gains), artifact.T_s, artifact.K2, artifact.loop, stiffness
        if key not in known:
            known[key] = margins_at(artifact, stiffness)
        return known[key]

    recomputed_margins.margins_at = remembered


def remember_runtimes() -> None:
    """Record each law once: loader and `check` replay the same, and most inputs leave the good one as it is."""
    known: dict[str, ArmRuntime] = {}

    def remembered(artifact: Artifact) -> ArmRuntime:
        controller = *flown_controller(artifact), artifact.preview
        key = exact(controller)
        if key not in known:
            if len(known) > 100:
                known.clear()
            known[key] = ArmRuntime(*controller)
        return known[key]

    golden.arm_runtime = remembered


if __name__ == "__main__":
    sys.exit(main())
