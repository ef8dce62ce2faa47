"""Compute what is missing of a sweep, chunk by chunk; the same spec gives the same bits however it got there."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from jaxmpc.beside import Beside
from jaxmpc.files.errors import InputError, check_type
from jaxmpc.status import Status
from jaxmpc.terminal.progress import Tick
from jaxmpc.terminal.progress import progress as progress_of
from sweeps import chunks, environments, store
from sweeps.chunks import StoredChunks
from sweeps.compute import baseline, compiles_long, round_of
from sweeps.crew import Alone, ComputedChunk, Crew
from sweeps.decided import folder_of, likely_in_float64, plan_in_float64, read_again, with_decided
from sweeps.engines import engine_of
from sweeps.goal import MEASURED, SweepGoal
from sweeps.interrupt import gently
from sweeps.judged import Point, baseline_of, keeps, worst
from sweeps.leases import SILENCE, Leases
from sweeps.machine import environment
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan, check_chunk, make_plan
from sweeps.precision import with_precision
from sweeps.result import Result
from sweeps.share import Share, check_part
from sweeps.spec import SweepSpec
from sweeps.tables import OnError
from sweeps.writer import Writer

HEAD_START = 4.0
"""For so long the rows' own program is alone: where it is compiled already, tracing another would only delay it [s]."""
MakeCrew = Callable[[Callable[[Columns], None]], Crew]
"""Makes whoever computes, of what wants to see the columns of each round."""


class SweepStoppedError(RuntimeError):
    """A chunk could not be computed, and the spec says to stop; the message says which and why."""


def run(
    spec: SweepSpec,
    folder: str | Path,
    *,
    chunk: int | None = None,
    part: tuple[int, int] = (1, 1),
    progress: bool = False,
    gentle: bool = False,
    retry: bool = False,
    silence: float = SILENCE,
    crew: MakeCrew = Alone,
    paced: Callable[[Plan, Pace], None] | None = None,
    told: Callable[[str], None] = lambda text: None,
) -> Result:
    """Run a sweep, or what is missing of it; several processes may do so in one folder, and share the work.

    Bad controllers never stop it: their `Status` says what happened. Whatever stops it, call it again with
    the same arguments: at most the chunk in work is lost. When all is there, the rows that float32 cannot decide run
    once more in float64, `spec.goal.decide` of them at most.

    Args:
        spec: What is swept.
        folder: Where its chunks go: new, empty, or begun by the same spec.
        chunk: Rows of a chunk file, by default a few seconds of work; no bit of the result depends on it.
        part: k and n: begin with the k-th of n parts, and help with the others afterwards.
        progress: Show it on standard error.
        gentle: Whether Ctrl-C finishes the round in work; `Result.complete` then tells.
        retry: Whether to try again what was set aside before.
        silence: After so long without a sign of life another process takes a chunk over [s].
        crew: Who computes.
        paced: Told at the end how long rows took.
        told: Called with a line before rows run once more.

    Returns:
        Every row; those that are there, where chunks were set aside or somebody stopped it.

    Raises:
        InputError: The spec is none, the folder belongs to something else, or an argument is out of bounds.
        SweepStoppedError: A chunk could not be computed, and `spec.on_error` is "stop".
        OSError: The folder cannot be written, or the disk is full.
    """
    check_type("spec", spec, SweepSpec, "Read one with SweepSpec.from_toml(FILE).")
    folder, started = Path(folder), threading.Event()
    plan = make_plan(with_precision(spec, folder))
    chunk = None if chunk is None else check_chunk(plan, chunk)
    part = check_part(part)
    if not (isinstance(silence, int | float | np.number) and 0.0 < silence < math.inf):
        raise InputError("silence", silence, "positive and finite [s]", f"{SILENCE:g} s are usual.")

    def computed(plan: Plan, folder: Path, chunk: int | None, stop: Callable[[], bool]) -> Result:
        here = environment(engine_of(plan))
        store.prepare(folder, plan)
        environments.note(folder, here)
        found = chunks.read_chunks(folder, plan, mend=True)
        leases = Leases(folder, silence)
        try:
            if retry:
                leases.retry()
            share = Share(folder, plan, found.there, leases, part)
            with progress_of("sweep", len(found.there), enabled=progress) as tick:
                count = _Count(tick, plan.goal, share)
                pace = Pace(chunk, round_of(plan), plan.largest_chunk)

                def made(columns: Columns) -> None:
                    started.set()
                    count.add(columns)

                makers = crew(made)
                try:
                    with Writer() as writer:
                        for piece in makers.work(plan, share, leases, pace, lambda: stop() or writer.failed):
                            writer.begin(partial(_keep, folder, plan, piece, found, share, leases, spec.on_error))
                            if piece.ends:
                                # No other is begun before: who is killed loses one stretch.
                                writer.settle()
                finally:
                    makers.close()
        finally:
            leases.close()
        if paced is not None:
            paced(plan, pace)
        # What this process has written it need not read.
        return Result.of(plan, *chunks.read_chunks(folder, plan, known=found))

    with gently(gentle) as stop:
        with Beside(1) as beside:
            if (ahead := _worth_readying(plan, folder, crew)) is not None:
                beside.submit(_readied, ahead, started)
            try:
                result = computed(plan, folder, chunk, stop)
            finally:
                started.set()  # where no row was missing nobody has
        if not result.complete:
            return result
        if (again := plan_in_float64(plan, result.columns)) is not None:
            if stop():
                found = read_again(folder, again)
            else:
                told(f"float64: {len(again.rows)} rows that float32 cannot decide, once more")
                # What fits a file in float32 may not in float64.
                most = chunk and min(chunk, again.largest_chunk)
                found = dict(computed(again, folder_of(folder, again), most, stop).columns)
            columns, decided = with_decided(result.columns, again, found)
            result = replace(result, columns=columns, decided=decided)
        return _finished(folder, result) if result.complete else result


def _worth_readying(plan: Plan, folder: Path, crew: MakeCrew) -> Plan | None:
    """What has the program compiled that runs rows once more, if it is to be while the first ones run."""
    begun = (folder / "float64").is_dir()
    return likely_in_float64(plan) if crew is Alone and compiles_long() and not begun else None


def _readied(plan: Plan, started: threading.Event) -> None:
    started.wait(HEAD_START)
    baseline(plan)


def _keep(
    folder: Path,
    plan: Plan,
    piece: ComputedChunk,
    found: StoredChunks,
    share: Share,
    leases: Leases,
    on_error: OnError,
) -> None:
    """Write what was computed, or set aside what could not be; give the lease back."""
    done = False
    try:
        if piece.columns is None:
            if on_error == "stop":
                numbers = f"{plan.rows[piece.first]} … {plan.rows[piece.last - 1]}"
                raise SweepStoppedError(f"rows {numbers} could not be computed: {piece.error}")
            leases.set_aside((piece.first, piece.last), piece.error)
        else:
            if piece.environment:
                environments.note(folder, piece.environment)
            chunks.write_chunk(folder, plan, piece.first, piece.last, piece.columns)
            found.add(piece.first, piece.last, piece.columns)
            share.done((piece.first, piece.last))
        done = True
    finally:
        if piece.ends or not done:
            share.give_back(piece.stretch)


def _finished(folder: Path, result: Result) -> Result:
    """The result with its baseline; its summary is written unless it is there."""
    summary = store.read_summary(folder)
    point = baseline_of(summary) or _baseline(result.plan)
    result = replace(result, baseline=point)
    if summary.get("result_hash") != result.hash:
        # JSON has no infinity: an unstable baseline is null.
        written = [value if math.isfinite(value) else None for value in point]
        counts = result.status_counts()
        summary = {"result_hash": result.hash, "rows": len(result), "status": counts, "baseline": written}
        store.write_summary(folder, summary)
    return result


def _baseline(plan: Plan) -> Point:
    outcome = baseline(plan)
    if not (np.asarray(outcome.status) == Status.OK).all():
        return Point(math.inf, math.inf)
    return Point(float(np.max(outcome.metrics.rms)), float(np.max(outcome.margins.M_s)))


class _Count:
    """What the progress line says: rows of this process at once, those of others as they come."""

    def __init__(self, tick: Tick, goal: SweepGoal, share: Share) -> None:
        self._tick, self._goal, self._share = tick, goal, share
        self._mine, self._before, self._bad = 0, int(share.there.sum()), 0
        self._best: float | None = None
        self._began: tuple[float, int] | None = None

    def add(self, columns: Columns) -> None:
        """Rows of a round."""
        ok = (columns["status"] == Status.OK).all(axis=1)
        self._mine, self._bad = self._mine + len(ok), self._bad + int((~ok).sum())
        good = ok & np.all([keeps(columns, name, limit) for name, limit in self._goal.constraints.items()], axis=0)
        if good.any():
            values = worst(columns, self._goal.best)[good]
            ceiling = MEASURED[self._goal.best].ceiling
            found = float(values.min() if ceiling else values.max())
            better = self._best is None or (found < self._best) == ceiling
            self._best = found if better else self._best
        best = "none good yet" if self._best is None else f"best {MEASURED[self._goal.best].amount(self._best, '.4g')}"
        now = time.monotonic()
        # From the end of the first round: that one also compiled.
        start, before = self._began = self._began or (now, self._mine)
        rate = f"{(self._mine - before) / (now - start):.0f} rows/s, " if now > start else ""
        # Rows of others and of this process's chunk in work; the latter are not yet there.
        done = min(max(int(self._share.there.sum()), self._before + self._mine), len(self._share.there))
        self._tick(done, f"{rate}{self._bad} not OK, {best}")
