"""What a dry run tells of memory is what a sweep takes: measured, with rows that cost nothing to compute."""

import re
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sweeps.axis import SweepAxis
from sweeps.blocks import signal_bytes
from sweeps.crew import ComputedChunk, Crew, Stop
from sweeps.dry_run import PROCESS_MB, dry_run
from sweeps.judged import Point
from sweeps.leases import Leases
from sweeps.pace import Pace
from sweeps.plan import Columns, Plan, make_plan
from sweeps.run import run
from sweeps.share import Share
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec

ROWS = 160_000
"""65 MB of columns: more than anything beside them, and than the buffer into which a file is read (64 MB)."""


class Drawing(Crew):
    """Rows whose values are drawn, some of which float32 cannot decide."""

    def __init__(self, told: Callable[[Columns], None]) -> None:
        del told

    def work(self, plan: Plan, share: Share, leases: Leases, pace: Pace, stop: Stop) -> Iterator[ComputedChunk]:
        del leases, pace, stop
        random, swept = np.random.default_rng(0), plan.space.columns(plan.rows)
        while (stretch := share.next(4096)) is not None:
            part = slice(*stretch)
            columns = {
                name: random.uniform(1.0, 1.5, (part.stop - part.start, *column.shape)).astype(column.dtype)
                for name, column in plan.layout.items()
            }
            # Every row is OK, and no torque limit acts.
            columns |= {name: np.zeros_like(columns[name]) for name in ("status", "clamped")}
            columns |= {"row": plan.rows[part], **{name: values[part] for name, values in swept.items()}}
            yield ComputedChunk(stretch, *stretch, columns)


@pytest.mark.parametrize("decide", [0, 100])
def test_a_dry_run_tells_the_memory_that_a_sweep_takes(
    decide: int, spec: SweepSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows in float64 are put in a copy of all others: at that moment every column is there twice.

    Measured with two tissues and all columns, 410 bytes a row: 1.13 times these without rows in float64, 2.09 times
    with them.
    """
    monkeypatch.setattr("sweeps.run._baseline", lambda plan: Point(1.0, 1.0))
    factors = tuple((SweepAxis(name, "log", (0.01, 1.0)),) for name in ("lam", "Q_p"))
    space = SweepSpace("random", factors, ROWS, 0, spec.space.horizons)
    big = replace(spec, space=space, goal=msgspec.structs.replace(spec.goal, decide=decide))
    plan = make_plan(big)
    said = re.search(r"memory +(\d+) MB", dry_run(big, plan, 2, measure=False))
    assert said
    told = 1e6 * (float(said[1]) - PROCESS_MB) - signal_bytes(plan)
    tracemalloc.start()
    try:
        result = run(big, tmp_path / "run", crew=Drawing)
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert result.complete
    assert (0 if result.decided is None else len(result.decided.plan.rows)) == decide
    assert told == pytest.approx(taken, rel=0.15)
