"""Loader and `check` against re-sealed artifacts: a valid seal around wrong content, a million times.

    python -m benchmarks.artifact_fuzz --inputs 1000000 --minutes 60

Counts inputs, refusals, exceptions and the longest processor time (nothing here waits); of what is accepted, what is
changed in it and whether that is absurd: another law than the file's, a limit or a place that no arm has.
Each input is drawn by its number alone: the same command with --first goes on elsewhere.
"""

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
import time
from argparse import Namespace
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from deploy.cli import check
from deploy.controller import recomputed_margins
from deploy.controller.arm_model import GOLDEN
from deploy.controller.artifact import Artifact
from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from deploy.controller.limits import MECHANICAL_STOPS, REACH
from deploy.controller.recomputed_margins import margins_at
from deploy.controller.runtimes import arm_runtime
from deploy.loop.session import HEART, deepest
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
    arm = None if artifact.arm is None else {k: v for k, v in vars(artifact.arm).items() if k not in GOLDEN}
    return repr((artifact.gains, artifact.T_s, artifact.K2, artifact.preview, artifact.loop, arm))


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


def main() -> int:
    """Attack, and tell; 1 after an exception, a hang or something absurd."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first (0)")
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    good = made.arm_artifact(12)
    rows = [margins_at(good, row["stiffness"]) for row in good.margins]
    good = Artifact(**{**vars(good), "margins": rows, "floor": {"M_s": 5.0}})
    data, expected = to_bytes(good), torques(good)
    header, arrays = unseal(data)
    header = json.loads(json.dumps(header))
    remember_margins()
    check._times = lambda artifact, count=0: [0.0] * 100  # twenty thousand steps are timed: that is no parsing
    tally, refusals, passed, strange = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    longest, began, number = 0.0, time.monotonic(), args.first
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        path = Path(folder) / "controller.npz"
        for number in range(args.first, args.first + args.inputs):
            if time.monotonic() - began > 60.0 * args.minutes:
                break
            dice = np.random.default_rng((args.seed, number))
            content, what = forged(dice, data, header, arrays)
            if content == data:
                tally["the same"] += 1
                continue
            tally["inputs"] += 1
            start = time.process_time()
            try:
                found = from_bytes(content)
            except ArtifactError as error:
                refusals[str(error)[:24]] += 1
                longest = max(longest, time.process_time() - start)
                continue
            except Exception as error:
                strange[f"{type(error).__name__}: {error} at {what}, number {number}"] += 1
                continue
            tally["accepted by the loader"] += 1
            path.write_bytes(content)
            said = io.StringIO()
            try:
                with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                    code = check.run(Namespace(artifact=path, require_signature=None))
                longest = max(longest, time.process_time() - start)
                wrong = absurd(found, good, expected)
            except Exception as error:
                strange[f"{type(error).__name__}: {error} at {what}, number {number}"] += 1
                continue
            tally["refused by check" if code else "accepted by both"] += 1
            if wrong:
                where = "by both" if code == 0 else "by the loader alone"
                strange[f"absurd, accepted {where}: {wrong} at {what}, number {number}"] += 1
            if code == 0:
                passed[what.partition(" = ")[0]] += 1
    print(f"numbers {args.first} to {number}, {time.monotonic() - began:.0f} s")
    print(", ".join(f"{key} {count}" for key, count in tally.items()))
    print(f"refused by the loader {refusals.total()}, for {len(refusals)} reasons; longest time {1e3 * longest:.0f} ms")
    print("accepted by both: " + ", ".join(f"{what} {count}" for what, count in passed.most_common()))
    print(f"exceptions and absurdities: {strange.total()}")
    print("".join(f"  {count} × {what}\n" for what, count in strange.most_common(40)), end="")
    return int(strange.total() > 0 or longest > 1.0)


def remember_margins() -> None:
    """Compute margins once for each loop: most inputs leave the loop as it is, and a row takes 0.1 s."""
    known: dict[tuple[Any, ...], dict[str, float]] = {}

    def remembered(artifact: Artifact, stiffness: float) -> dict[str, float]:
        key = repr(artifact.gains), artifact.T_s, artifact.K2, artifact.loop, stiffness
        if key not in known:
            known[key] = margins_at(artifact, stiffness)
        return known[key]

    recomputed_margins.margins_at = remembered


if __name__ == "__main__":
    sys.exit(main())
