"""Random trials of finished controllers on the arm: who is lost, or swings, where nobody has tuned?

A trial is an `Experiment` of its own, drawn from its seed and number alone, so that any one can be run again by itself;
every controller meets the same. A heart's motion costs more than running a controller on it, so `COPIES` trials, each
on a robot and a tissue of its own, share one (and its sensor noise). They are not independent then: of failures it also
matters on how many motions they occurred.

Three verdicts, of which a trial may deserve several:

- *lost*: its status is any but OK; or |e| ≥ 2 N after the first 2 s (ramps included) in a loop whose linearisation with
  the whole arm, at full gain, is unstable, or whose force grows: it still swings at the end.
- *left 2 N*: |e| ≥ 2 N after the first 2 s, not lost: an event pushed a stable loop.
- *swinging*: true force above 12 Hz of more than 0.1 N RMS on any axis over the last 10 s (`jaxmpc.swing`).
"""

import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from jaxmpc.files.alone import alone_in
from jaxmpc.files.errors import InputError, check_type, counted
from jaxmpc.files.foreign import read_bytes
from jaxmpc.files.sealed import LARGEST, SealError, seal, unseal, write_atomic
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.store import source_of
from tuning.trials import drawn
from tuning.trials.compute import outcomes_of
from tuning.trials.drawn import HARD, MOST, NOMINAL, Drawn, Job, Spread, motion_of, on_own_tissues
from tuning.trials.outcomes import Outcomes

__all__ = [
    "HARD",
    "MOST",
    "NOMINAL",
    "Drawn",
    "Job",
    "Outcomes",
    "Spread",
    "motion_of",
    "on_own_tissues",
    "run",
]

log = logging.getLogger(__name__)

Told = Callable[[int, Outcomes], None]
"""Called with the first trial of a block and its outcomes, as soon as they are there."""


def run(
    job: Job, count: int, folder: str | Path | None = None, show: bool = False, told: Told | None = None
) -> Outcomes:
    """Run trials 0 … count − 1; no bit of one depends on how many there are or where a run was interrupted.

    Args:
        job: Who meets what.
        count: Number of trials.
        folder: Where finished blocks are kept and found again; None keeps none.
        show: Whether to show progress.
        told: Hears of each block.

    Raises:
        InputError: The count is out of bounds, an argument of another type, nobody is tried, the folder holds blocks of
            another job or program, or another process works in it.
    """
    check_type("job", job, Job, "Make one with Job((params,), experiment).")
    if not job.controllers:
        raise InputError("controllers", "none", "at least one", "Make the job with Job((params,), experiment).")
    count = counted("trials", count, "10000 is usual.", 1, MOST)
    check_type("folder", folder, str | Path | None, "Give a path, or None to keep none.")
    place = None if folder is None else Path(folder)
    blocks: list[Outcomes] = []
    lost, swinging = np.zeros((2, len(job.controllers)), int)
    with alone_in(place), progress("trials", count, "trials", show) as tick:
        for first, found in _all_blocks(job, count, place):
            blocks.append(Outcomes(*(field[: count - first] for field in found)))
            lost += blocks[-1].lost.sum(axis=0)
            swinging += blocks[-1].swinging.sum(axis=0)
            said = " / ".join(f"{a} lost, {b} swinging" for a, b in zip(lost, swinging, strict=True))
            if told:
                told(first, blocks[-1])
            tick(min(first + drawn.BLOCK, count), said)
    return Outcomes(*map(np.concatenate, zip(*blocks, strict=True)))


def _all_blocks(job: Job, count: int, folder: Path | None) -> Iterator[tuple[int, Outcomes]]:
    """Each block with its first trial, from its file, or computed and kept."""
    firsts = range(0, count, drawn.BLOCK)
    kept = {first: _kept(job, folder, first) for first in firsts}
    computed = outcomes_of(job, [first for first in firsts if kept[first] is None])
    for first in firsts:
        found = kept.pop(first)
        if found is None:
            found = next(computed)
            if folder is not None:
                write_atomic(_file(folder, first), seal(_header(job, first), found._asdict()))
        yield first, found


def _kept(job: Job, folder: Path | None, first: int) -> Outcomes | None:
    """A block from its file; None where there is none, or a damaged one.

    Raises:
        InputError: It is of other trials or another program, or the system does not let it be read, whole or not.
    """
    if folder is None or not os.path.lexists(path := _file(folder, first)):
        return None
    try:
        said, arrays = unseal(read_bytes(path, LARGEST))
    except SealError as error:
        log.warning("%s is computed again: %s", path.name, error)
        return None
    own = _header(job, first)
    if any(said.get(key) != own[key] for key in ("kind", "job", "first")):
        raise InputError("output folder", folder, "one of these very trials", "Choose another with -o.")
    if said != own:
        remedy = "What it measures may have been something else before: choose another with -o."
        raise InputError("output folder", folder, "one that this very program has begun", remedy)
    return Outcomes(**arrays)


def _file(folder: Path, first: int) -> Path:
    return folder / f"{first:07d}.npz"


def _header(job: Job, first: int) -> dict[str, object]:
    made_by = {package: source_of(package) for package in ("jaxmpc", "tuning")}
    return {"kind": "jaxmpc trials", "job": job.digest, "first": first, **made_by}
