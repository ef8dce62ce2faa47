"""What a sweep would take, told before it is run: rows, compilations, memory, disk, time, and what computes it."""

import math
import time
from pathlib import Path

from jaxmpc.quantities import METRICS
from sweeps import rates, store
from sweeps.blocks import block_of, in_pairs, padded, programs, signal_bytes
from sweeps.compiling import so_far
from sweeps.decided import plan_in_float64
from sweeps.engines import Devices, devices, engine_of
from sweeps.machine import processor
from sweeps.pace import CHUNK_SECONDS, Pace
from sweeps.plan import Plan
from sweeps.result import Result
from sweeps.show.best_rows import progress
from sweeps.spec import SweepSpec

PROCESS_MB = 500
"""Memory of a process that has compiled something, beside its rows and signals [MB]."""


def dry_run(spec: SweepSpec, plan: Plan, cores: int, *, measure: bool) -> str:
    """What a sweep would take on this machine, for a person; nothing is written but recorded rates.

    Args:
        spec: What is swept.
        plan: The same, resolved.
        cores: How many compute.
        measure: Whether to compute the first rows to find out how fast they are, if all are alike.
    """
    if measure and not rates.uneven(plan):
        _measured(plan, cores)
    rows, compiled, experiment = len(plan.rows), programs(plan), plan.canonical["experiment"]
    there = devices(cores)
    took = rates.estimate(plan, there)
    each = "rows of one world" if plan.space.of_worlds and not in_pairs(plan) else "rows"
    way = "pairs of a controller and a world" if in_pairs(plan) else f"controllers × {_counted(plan.worlds, 'world')}"
    memory = rows * row_memory(plan) + signal_bytes(plan) * (block_of(plan) * there.number if in_pairs(plan) else 1)
    lines = [
        f"  engine      {engine_of(plan)}, {experiment['physics']} on {_named(there)}",
        f"  blocks      of {block_of(plan)} {each}, {way}",
        f"  compiles    {_counted(compiled, 'program')}",
        f"  disk        {rows * plan.row_bytes / 1e6:.1f} MB",
        f"  memory      {memory / 1e6 + PROCESS_MB:.0f} MB",
        f"  axis-steps  {rows * 3 * rates.samples_of(plan):.3g}",
    ]
    if took is None and rates.uneven(plan):
        lines.append("  time        unknown: an axis changes what a row costs")
    elif took is None:
        lines.append("  time        unknown: nothing like it has been run on this machine; --measure finds out")
    else:
        start = "start, compiled before" if took.remembered else "compile"
        parts = f"{took.start_s:.0f} s to {start}, then {took.rate:.0f} rows/s"
        chunks = max(1, round(took.rows / took.rate / CHUNK_SECONDS))
        lines.append(f"  time        {took.seconds:.0f} s from nothing: {parts} (from {took.like})")
        lines.append(f"  chunks      {chunks} of some seconds each")
    if plan.canonical["precision"] == "float32" and spec.goal.decide:
        lines.append(f"  float64     then once more what float32 cannot decide, {spec.goal.decide} rows at most")
    if spec.refine is not None:
        refined = "what stands above is of all rows on the spec's own experiment"
        lines.append(f"  refined by  {spec.refine.method}: {refined}")
    but = " but how fast that was, for estimates" if measure else ""
    return "\n".join([*lines, f"dry run: nothing was written{but}"])


def there(folder: Path, plan: Plan) -> str:
    """What of a sweep that has been begun is there, and whether that is all, for a person.

    Args:
        folder: The sweep's.
        plan: What is swept, ranked as it is to be now.
    """
    if store.read_manifest(folder).get("schema") == store.REFINED and not store.stage_folders(folder):
        return "nothing yet"
    result = Result.load(folder)
    if not result.complete:
        return progress(result)
    # Folders from before, and those of another ranking, hold rows that float32 leaves to chance.
    decided = result.stages or result.decided or plan_in_float64(plan, result.columns) is None
    if result.goal == plan.goal and decided:
        return "all of it: the sweep is finished, and nothing is left to compute"
    return "every row; what float32 cannot decide of this ranking is left"


def row_memory(plan: Plan) -> int:
    """Memory of a row when all are there, which is when a sweep needs most [bytes].

    Its columns, its number and entries; where rows run once more in float64 all columns a second time, since those rows
    are put in a copy of the others, in which what ranks and limits has all digits of float64.
    """
    planned = 8 * (1 + len(plan.space.axes))
    if plan.canonical["precision"] == "float64" or not plan.goal.decide:
        return plan.row_bytes + planned
    exact = {name for name in plan.goal.names if name in METRICS}
    digits = sum(4 * math.prod(plan.layout[name].shape) for name in exact)
    return 2 * plan.row_bytes + digits + planned


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" + "s" * (number != 1)


def _named(there: Devices) -> str:
    """What computes on this machine, in words."""
    return f"{there.number} cores" if there.kind == processor() else f"{there.number} × {there.kind}"


def _measured(plan: Plan, cores: int) -> None:
    """Compute the first rows, two rounds, and note how long they took."""
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores(cores)
    from sweeps.compute import compute, round_of

    width = min(round_of(plan), len(plan.rows))
    pace, there = Pace(None, width, plan.largest_chunk), devices(cores)
    for _ in range(2):
        began, before = time.perf_counter(), so_far()
        compute(plan, 0, width)
        pace.tell(padded(plan, there.number, 0, width), time.perf_counter() - began, so_far().since(before))
    rates.record(plan, pace, there)
