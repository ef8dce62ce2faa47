"""Compute what is missing of a sweep, chunk by chunk; the same spec gives the same bits however it got there."""

import math
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmpc.closed_loops import Outcome, evaluate_block
from jaxmpc.engine.scene import ProgramSpec, program_spec, scenario_data
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from jaxmpc.terminal.progress import Tick
from jaxmpc.terminal.progress import progress as progress_of
from jaxmpc.xla.blocks import BLOCK, over_blocks
from sweeps import store
from sweeps.plan import CHUNK, Plan, check_chunk, make_plan
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
    evaluate = _evaluator(spec)
    with progress_of("sweep", len(plan.rows), enabled=progress) as tick:
        count = _Count(tick, int(there.sum()))
        for first, last in plan.portions(~there, chunk):
            found = _rows(evaluate, plan, first, last, count)
            store.write_chunk(folder, plan, first, last, found)
            for name, values in found.items():
                columns[name][first:last] = values
    result = Result(plan, columns)
    summary = store.read_summary(folder)
    if summary.get("result_hash") != result.hash:
        point = _point(_outcome_columns(evaluate(spec.params.with_columns({"lam": spec.params.lam[None]}))))
        # JSON has no infinity: an unstable baseline is null.
        baseline = [value if math.isfinite(value) else None for value in point]
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
    plan, evaluate = make_plan(spec), _evaluator(spec)
    batch = plan.params(0, min(len(plan.rows), BLOCK * jax.local_device_count()))
    times = []
    for _ in range(2):
        began = time.perf_counter()
        evaluate(batch)
        times.append(time.perf_counter() - began)
    return CostEstimate(max(times[0] - times[1], 0.0), batch.batch_shape[0] / times[1])


class _Count:
    """What the progress line says of the rows computed in this run."""

    def __init__(self, tick: Tick, done: int) -> None:
        self.tick, self.done, self.bad, self.best = tick, done, 0, math.inf
        self.began: tuple[float, int] | None = None

    def add(self, columns: store.Columns) -> None:
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


@lru_cache(maxsize=8)
def _program(world: ProgramSpec, precision: str) -> Callable[[Any, Any], Any]:
    return over_blocks(partial(evaluate_block, world=world, dtype=precision))


def _evaluator(spec: SweepSpec) -> Callable[[Params], Outcome]:
    """One compiled program for all rounds of a sweep, and for all sweeps of its kind in this process."""
    experiment = spec.experiment
    scene = scenario_data(experiment)
    program = _program(program_spec(experiment), spec.precision)

    def evaluate(batch: Params) -> Outcome:
        with jax.enable_x64(True):
            outcome: Outcome = program(batch, scene)
        return outcome

    return evaluate


def _rows(evaluate: Callable[[Params], Outcome], plan: Plan, first: int, last: int, count: _Count) -> store.Columns:
    """Columns of planned rows first … last − 1, computed in rounds of one block a device: one compilation."""
    batch, width = plan.params(first, last), BLOCK * jax.local_device_count()
    rounds = []
    for begin in range(0, last - first, width):
        rounds.append(_outcome_columns(evaluate(batch[begin : begin + width])))
        count.add(rounds[-1])
    rows = plan.rows[first:last]
    given = {"row": rows} | plan.space.columns(rows)
    found = {name: np.concatenate([each[name] for each in rounds]) for name in rounds[0]}
    return {name: np.asarray((given | found)[name], column.dtype) for name, column in plan.layout.items()}


def _outcome_columns(outcome: Outcome) -> store.Columns:
    measured = outcome.metrics._asdict() | outcome.margins._asdict()
    columns = {name: np.array(measured[name]) for name in (*METRICS, *MARGINS)}
    for values in columns.values():
        # One NaN, whatever sign and payload the processor made.
        values[np.isnan(values)] = np.nan
    return columns | {"status": np.asarray(outcome.status)}


def _point(columns: store.Columns) -> Point:
    if (columns["status"] == Status.OK).all():
        return Point(float(columns["rms"].max()), float(columns["M_s"].max()))
    return Point(math.inf, math.inf)
