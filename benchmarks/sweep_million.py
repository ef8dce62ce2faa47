"""A sweep's folder of 10⁶ rows, opened, its best rows and its front: `python -m benchmarks.sweep_million`.

The numbers in it are made up, the files are those of a sweep: three axes, three tissues, every metric and margin,
chunks of 8192 rows. It is opened by a process of its own, whose largest memory is told. Processor time is told beside
wall time: on a machine with nothing else to do they are alike.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROWS, CHUNK = 1_000_000, 8192


def main() -> None:
    """Make the folder and open it, or, as that other process, measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--kind", choices=("grid", "random"), default="grid")
    parser.add_argument("--open", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.open is not None:
        measured(args.open)
        return
    with tempfile.TemporaryDirectory() as folder:
        made_up(Path(folder), args.rows, args.kind)
        files = sum(path.stat().st_size for path in Path(folder).rglob("*.npz"))
        print(f"{args.rows} rows of a {args.kind} sweep, {files / 1e6:.0f} MB", flush=True)
        subprocess.run([sys.executable, "-m", "benchmarks.sweep_million", "--open", folder], check=True)


def measured(folder: Path) -> None:
    """Open a folder and ask it, each step timed."""
    before = time.process_time(), time.perf_counter()

    def lap(name: str) -> None:
        nonlocal before
        now = time.process_time(), time.perf_counter()
        processor, wall = now[0] - before[0], now[1] - before[1]
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"{name:26} {processor:6.2f} s of processor {wall:6.2f} s of wall, memory so far {largest:5.0f} MB")
        before = now

    # Imported here: what that takes is a line of the result.
    from sweeps.result import Result

    lap("importing")
    result = Result.load(folder)
    lap("opening, every seal checked")
    best = result.best(10)
    lap("the ten best rows")
    front = result.pareto("rms", "M_s", "chatter")
    lap("Pareto front of three goals")
    print(f"{len(result)} rows, {len(best)} best ones, {len(front)} on the front")


def made_up(folder: Path, rows: int, kind: str) -> None:
    """Write a sweep's folder whose values are drawn, not computed."""
    from sweeps import chunks, store
    from sweeps.plan import make_plan
    from sweeps.spec import SweepSpec

    ends = {"lam": (0.01, 1.0), "T_cl": (0.001, 0.01), "Q_p": (0.1, 1.0)}
    points = {"points": round(rows ** (1 / 3))} if kind == "grid" else {}
    table = {"rows": rows, "seed": 1} if kind == "random" else {}
    axes = {name: {"log": list(pair), **points} for name, pair in ends.items()}
    spec = SweepSpec.from_dict({"experiment": {"published": "table-1"}, "sweep": {"kind": kind, "axes": axes, **table}})
    plan, random = make_plan(spec), np.random.default_rng(1)
    store.prepare(folder, plan)
    swept = plan.space.columns(plan.rows)
    for first in range(0, len(plan.rows), CHUNK):
        part = slice(first, min(first + CHUNK, len(plan.rows)))
        drawn = {
            name: random.random((part.stop - first, *column.shape)).astype(column.dtype)
            for name, column in plan.layout.items()
        }
        own = {name: values[part] for name, values in swept.items()}
        # One in ten has failed somewhere, one in five keeps the limit of M_s.
        status = (random.random(drawn["status"].shape) < 0.03).astype(np.int8)
        peaks = {"M_s": 1.2 + 3.0 * drawn["M_s"]}
        columns = {**drawn, **own, **peaks, "row": plan.rows[part], "status": status}
        chunks.write_chunk(folder, plan, first, part.stop, columns)


if __name__ == "__main__":
    main()
