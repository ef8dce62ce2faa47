"""Plants known faults, each alone in a copy of the tree, and asks the tests: `make planted-faults`.

A fault is caught by the fast tests, by the oracles, or not at all; at most two may be left to the oracles. Names in the
arguments choose among the faults; what stands after -- goes to pytest instead of all tests.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxmpc", "tuning", "sweeps", "deploy")
ORACLES = ["-m", "oracle and not slow and not hardware"]
LEFT_TO_ORACLES = 2


class Fault(NamedTuple):
    name: str
    right: str
    """Stands once in the four packages, wherever that may be."""
    wrong: str


FAULTS = (
    Fault("tissue-changes-ignored", "stiffness=tissue.stiffness * now.softening", "stiffness=tissue.stiffness"),
    Fault("lost-contact-inverted", "indented < 0.0", "indented > 0.0"),
    Fault("sign-in-forward-dynamics", "tuple(dt - dr for dt, dr in zip(", "tuple(dt + dr for dt, dr in zip("),
    Fault(
        "no-anti-windup",
        "return add(command.v, computed_torque.acceleration_of(command.torque, change)), change",
        "return command.v, change",
    ),
    Fault(
        "velocity-filtered-twice",
        "new + pole * (old - new) for new, old in zip(raw",
        "(once := new + pole * (old - new)) + pole * (old - once) for new, old in zip(raw",
    ),
    Fault("rate-limit-ignored", "ops.clip(value, before - step, before + step)", "value"),
    Fault("float32-for-float64", "leaf.astype(dtype) if", 'leaf.astype("float32") if'),
    Fault(
        "delay-one-sample-short",
        "return state._replace(pending=(torque, newest))",
        "return state._replace(pending=(torque, torque))",
    ),
)


def plant(fault: Fault, root: Path) -> str:
    """Put the fault into a tree; returns the file that has it."""
    files = [path for package in PACKAGES for path in sorted(root.glob(f"{package}/**/*.py"))]
    places = [path for path in files for _ in range(path.read_text(encoding="utf-8").count(fault.right))]
    if len(places) != 1:
        raise SystemExit(f"{fault.name}: {fault.right!r} stands {len(places)} times in the packages, not once; mend it")
    path = places[0]
    path.write_text(path.read_text(encoding="utf-8").replace(fault.right, fault.wrong), encoding="utf-8")
    return path.relative_to(root).as_posix()


def first_failure(root: Path, arguments: list[str]) -> str | None:
    """What pytest says of the first test that fails, None where all pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *arguments]
    run = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if run.returncode == 0:
        return None
    told = [line for line in run.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    # Several workers that stop at the first failure end as if interrupted, with 2.
    if run.returncode not in (1, 2) or not told:
        raise SystemExit(f"pytest ended with {run.returncode}:\n{run.stdout[-2000:]}{run.stderr[-2000:]}")
    return told[0].partition(" ")[2]


def caught(fault: Fault, chosen: list[str]) -> str | None:
    """Who catches the fault: "fast" or "oracles"; None if nobody does."""
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in filter(None, tracked.split("\0")):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, root / name)
        place, began = plant(fault, root), time.monotonic()
        stages = {"chosen": chosen} if chosen else {"fast": [], "oracles": ORACLES}
        for stage, arguments in stages.items():
            failed = first_failure(root, arguments)
            if failed is not None:
                print(f"{fault.name} ({place}): {stage}, {time.monotonic() - began:.0f} s: {failed}", flush=True)
                return stage
        print(f"{fault.name} ({place}): NOT CAUGHT, {time.monotonic() - began:.0f} s", flush=True)
        return None


def main(arguments: list[str]) -> int:
    """0 if every fault is caught, all but two by the fast tests."""
    at = arguments.index("--") if "--" in arguments else len(arguments)
    names, chosen = arguments[:at], arguments[at + 1 :]
    if unknown := set(names) - {fault.name for fault in FAULTS}:
        raise SystemExit(f"unknown: {', '.join(unknown)}; there are {', '.join(fault.name for fault in FAULTS)}")
    found = [caught(fault, chosen) for fault in FAULTS if not names or fault.name in names]
    return int(None in found or found.count("oracles") > LEFT_TO_ORACLES)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
