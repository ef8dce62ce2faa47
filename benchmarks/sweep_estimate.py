"""What a dry run says, and what the run then takes, by the real command: `python -m benchmarks.sweep_estimate`.

The machine has seen one sweep before, of the same kind and other rows; its rates and programs lie in a cache of the
benchmark's own, empty at first. Then each case is estimated and run. Wall time, as the estimate is: on a busy machine
the factor is as noisy as its neighbours, so processor time is told beside it.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.sweep_overhead import Spent
from benchmarks.sweep_throughput import machine

SPEC = """\
[experiment]
published = "table-1"
duration = {seconds}
settle = 3.0

[params]
published = "text"

[sweep]
kind = "random"
rows = {rows}
seed = {seed}
axes = {{ lam = {{ log = [0.01, 1.0] }}, T_cl = {{ log = [0.001, 0.01] }}, Q_p = {{ log = [0.1, 1.0] }} }}
"""
SEEN = (4_000, 4.0)
ESTIMATE, TOOK = r"time +([\d.]+) s from nothing", r"rows after ([\d.]+) s"
CASES = ((4_000, 4.0), (20_000, 4.0), (50_000, 4.0), (5_000, 8.0))
"""Rows, and length of an episode [s]; the last is a program that has not been compiled before."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=len(CASES), help="how many of them")
    cases = CASES[: parser.parse_args().cases]
    print(machine(), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        said, _, used = swept(Path(folder), SEEN, 0)
        print(f"seen before: {SEEN[0]} rows of {SEEN[1]:g} s, {number(TOOK, said):.1f} s, {used:.1f} s of processor")
        for seed, case in enumerate(cases, 1):
            foretold, took, dry = swept(Path(folder), case, seed, "--dry-run")
            estimate = number(ESTIMATE, foretold)
            said, _, used = swept(Path(folder), case, seed)
            real = number(TOOK, said)
            print(
                f"{case[0]} rows of {case[1]:g} s: foretold {estimate:.0f} s,"
                f" took {real:.1f} s ({used:.1f} s of processor), factor {max(estimate / real, real / estimate):.2f};"
                f" the dry run took {took:.2f} s ({dry:.2f} s)",
                flush=True,
            )


def swept(folder: Path, case: tuple[int, float], seed: int, *more: str) -> tuple[str, float, float]:
    """What the command says, how long it takes, and of that processor time, imports included [s]."""
    spec = folder / f"{seed}.toml"
    spec.write_text(SPEC.format(rows=case[0], seconds=case[1], seed=seed))
    line = [sys.executable, "-m", "jaxmpc", "sweep", str(spec), "-o", str(folder / f"{seed}"), "--quiet", *more]
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    began = Spent.now()
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    took = Spent.now().plus(began, -1)
    return done.stdout, took.wall, took.processor


def number(pattern: str, text: str) -> float:
    """The number that a pattern finds.

    Raises:
        ValueError: It is not there.
    """
    if not (found := re.search(pattern, text)):
        raise ValueError(text)
    return float(found[1])


if __name__ == "__main__":
    main()
