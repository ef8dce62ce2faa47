"""Compute what is missing of a sweep, chunk by chunk; the same spec gives the same bits however it got there."""

import math
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc.status import Status
from jaxmpc.terminal.progress import Tick
from jaxmpc.terminal.progress import progress as progress_of
from sweeps import store
from sweeps.compute import compute, evaluated, rows_at_a_time
from sweeps.plan import CHUNK, Columns, check_chunk, make_plan
from sweeps.result import Point, Result, baseline_of
from sweeps.spec import SweepSpec

ROBUST = 2.0
"""Peak sensitivity up to which a controller counts as "best so far" [-]."""


def run(spec: SweepSpec, folder: str | Path, *, chunk: int = CHUNK, progress: bool = False) -> Result:
    """Run a sweep, or what is missing of it.

    Bad controllers never stop it: their `Status` says what happened. Whatever stops it, call it again with
    the same arguments: at most the chunk in work is lost.

    Args:
        spec: What is swept.
        folder: Where its chunks go: new, empty, or begun by the same spec.
        chunk: Rows of a chunk file; no bit of the result depends on it.
        progress: Show it on standard error.

    Returns:
        Every row.

    Raises:
        InputError: The folder belongs to something else, or the chunk is too large.
        OSError: The folder cannot be written, or the disk is full.
    """
    folder = Path(folder)
    plan = make_plan(spec)
    check_chunk(plan, chunk)
    store.prepare(folder, plan)
    columns, there = store.read_chunks(folder, plan)
    width = rows_at_a_time()
    with progress_of("sweep", len(plan.rows), enabled=progress) as tick:
        count = _Count(tick, int(there.sum()))
        for first, last in plan.portions(~there, chunk):
            for begin in range(first, last, width):
                end = min(begin + width, last)
                found = compute(spec, begin, end)
                for name, values in found.items():
                    columns[name][begin:end] = values
                count.add(found)
            store.write_chunk(folder, plan, first, last, {name: column[first:last] for name, column in columns.items()})
    result = Result(plan, columns)
    summary = store.read_summary(folder)
    if summary.get("result_hash") != result.hash:
        # JSON has no infinity: an unstable baseline is null.
        baseline = [value if math.isfinite(value) else None for value in _baseline(spec)]
        counts = result.status_counts()
        summary = {"result_hash": result.hash, "rows": len(result), "status": counts, "baseline": baseline}
        store.write_summary(folder, summary)
    return Result(plan, columns, baseline_of(summary))


class CostEstimate(NamedTuple):
    """What a sweep will take."""

    compile_s: float
    """First call of the compiled program [s]."""
    rate: float
    """Controllers per second after that [1/s]."""


def estimate(spec: SweepSpec) -> CostEstimate:
    """Measure the first rows of a sweep, two calls of as many rows as there are in one round."""
    rows = min(len(make_plan(spec).rows), rows_at_a_time())
    times = []
    for _ in range(2):
        began = time.perf_counter()
        compute(spec, 0, rows)
        times.append(time.perf_counter() - began)
    return CostEstimate(max(times[0] - times[1], 0.0), rows / times[1])


class _Count:
    """What the progress line says of the rows computed in this run."""

    def __init__(self, tick: Tick, done: int) -> None:
        self.tick, self.done, self.bad, self.best = tick, done, 0, math.inf
        self.began: tuple[float, int] | None = None

    def add(self, columns: Columns) -> None:
        ok = (columns["status"] == Status.OK).all(axis=1)
        robust = ok & (columns["M_s"] <= ROBUST).all(axis=1)
        if robust.any():
            self.best = min(self.best, float(columns["rms"][robust].max(axis=(1, 2)).min()))
        self.done, self.bad = self.done + len(ok), self.bad + int((~ok).sum())
        best = (
            f"best {self.best:.4f} N at M_s ≤ {ROBUST:g}" if math.isfinite(self.best) else f"none with M_s ≤ {ROBUST:g}"
        )
        now = time.monotonic()
        # From the end of the first round: that one also compiled.
        start, before = self.began = self.began or (now, self.done)
        rate = f"{(self.done - before) / (now - start):.0f} rows/s, " if now > start else ""
        self.tick(self.done, f"{rate}{self.bad} not OK, {best}")


def _baseline(spec: SweepSpec) -> Point:
    outcome = evaluated(spec, spec.params.with_columns({"lam": spec.params.lam[None]}))
    if (np.asarray(outcome.status) == Status.OK).all():
        return Point(float(np.max(outcome.metrics.rms)), float(np.max(outcome.margins.M_s)))
    return Point(math.inf, math.inf)
