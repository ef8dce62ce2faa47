"""What a sweep costs beyond its computing, alone and with Dask, in one run: `python -m benchmarks.sweep_overhead`.

Bare: the sweep's own compiled program over the same blocks, nothing kept. Half of it runs before the sweep and half
after, so that a machine that changes its speed meanwhile does so to both. Processor time counts, wall time is printed
beside it: only a machine with nothing else to do makes the two alike. Everything after compiling counts as the
sweep's: planning, rows to controllers, chunks, their seals and the disk, the baseline, reading back, the hash.
With Dask starting its workers counts as well, and each compiles for itself; bare is then charged its own start.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from benchmarks.sweep_throughput import machine
from jaxmpc.terminal.process import use_all_cores

if TYPE_CHECKING:
    from sweeps.spec import SweepSpec

ROWS, SECONDS, WORKERS, CORES = 100_000, 4.0, 2, 2


class Spent(NamedTuple):
    """Time of something."""

    processor: float
    """Of this process and of its children that have ended [s]."""
    wall: float
    """[s]."""

    @staticmethod
    def now() -> "Spent":
        """Since the process started, and since an arbitrary moment."""
        used = os.times()
        return Spent(used.user + used.system + used.children_user + used.children_system, time.perf_counter())

    def plus(self, other: "Spent", sign: int = 1) -> "Spent":
        """Both together."""
        return Spent(*(one + sign * two for one, two in zip(self, other, strict=True)))

    def over(self, other: "Spent") -> str:
        """How much more than another, for people."""
        more = (100.0 * (one / two - 1.0) for one, two in zip(self, other, strict=True))
        return "{:+.1f} % of processor time, {:+.1f} % of wall time".format(*more)


def taken(work: Callable[[], Any]) -> Spent:
    """What something takes."""
    began = Spent.now()
    work()
    return Spent.now().plus(began, -1)


def job(rows: int, seconds: float) -> "SweepSpec":
    """Random controllers on the linear loop, of which the last quarter of an episode is scored."""
    from sweeps.spec import SweepSpec

    # Of 4 s this is `table-1`'s own.
    ramp = {"kind": "ramp", "to": -5.0, "rate": 8.0 / seconds}
    lengths = {"duration": seconds, "settle": 0.75 * seconds, "reference": {"z": [ramp]}}
    return SweepSpec.from_dict(
        {
            "experiment": {"published": "table-1", **lengths},
            "params": {"published": "text"},
            "sweep": {
                "kind": "random",
                "precision": "float32",
                "rows": rows,
                "seed": 1,
                "axes": {"lam": {"log": [0.01, 1.0]}, "T_cl": {"log": [0.001, 0.01]}, "Q_p": {"log": [0.1, 1.0]}},
            },
        }
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of an episode: the shorter, the harder")
    args = parser.parse_args()
    use_all_cores(CORES)
    from sweeps.cluster import DaskCrew
    from sweeps.run import run

    spec = job(args.rows, args.seconds)
    halves = bare(spec)
    start = Spent.now()
    print(f"{machine()}, of which {CORES} are used; {args.rows} rows, linear loop, {args.seconds:g} s", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        before = taken(halves[0])
        alone = taken(partial(run, spec, Path(folder) / "alone"))
        computing = before.plus(taken(halves[1]))
        line("bare", computing)
        line("sweep, one process", alone, computing)
        crew = partial(DaskCrew, address=None, workers=WORKERS, cores=CORES)
        shared = taken(partial(run, spec, Path(folder) / "shared", crew=crew))
    # What it takes to import and compile, of which wall time is not told here.
    charged = Spent(computing.processor + start.processor, computing.wall)
    line(f"sweep, {WORKERS} Dask workers, their start included", shared, charged)
    print(f"of which starting and compiling took bare {start.processor:.1f} s of processor time")


def line(name: str, spent: Spent, bare_: Spent | None = None) -> None:
    """One row of the result."""
    over = f": {spent.over(bare_)}" if bare_ else ""
    print(f"{name:46} {spent.processor:8.1f} s of processor, {spent.wall:8.1f} s of wall{over}", flush=True)


def bare(spec: Any) -> tuple[Callable[[], None], Callable[[], None]]:
    """The blocks of a sweep's first and second half through its own program, which is compiled here."""
    import jax

    from jaxmpc.engine.scenario import program_spec
    from sweeps.blocks import block_of
    from sweeps.compute import _program, _scenario, round_of
    from sweeps.engines import chosen
    from sweeps.plan import make_plan
    from sweeps.rows import meetings

    plan = make_plan(spec)
    (meeting,) = meetings(plan.base, plan.space.axes, plan.space.columns(plan.rows), by_world=True)
    program = _program(chosen(program_spec(spec.experiment), plan), plan.canonical["precision"], block_of(plan))
    width, scene = round_of(plan), _scenario(spec.experiment)

    def over(first: int, last: int) -> None:
        with jax.enable_x64(True):
            for begin in range(first, last, width):
                rows = slice(begin, min(begin + width, last))
                program(jax.tree.map(lambda leaf, rows=rows: leaf[rows], meeting.params), scene)

    over(0, width)
    middle = len(plan.rows) // (2 * width) * width
    return partial(over, 0, middle), partial(over, middle, len(plan.rows))


if __name__ == "__main__":
    main()
