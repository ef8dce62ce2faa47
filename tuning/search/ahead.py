"""What a search on the arm comes to after its spectra, made ready beside them: the arm's problem, and its programs.

To compile them takes as long as to descend on the spectra, which waits for nothing of it.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

from jaxmpc.beside import Beside
from jaxmpc.xla.precision import in_float64
from tuning.job.spec import TuneSpec
from tuning.objective.problem import Problem, problem_of, training
from tuning.search import corrected
from tuning.search.mapping import PROPOSED, spectra_of

MOST = 4
"""Programs that compile at a time: of eight on a GPU each takes twice as long."""
Tasks = Sequence[Callable[[], None]]


class OnArm(NamedTuple):
    """A job on the arm."""

    runs: Problem
    """By runs."""
    spectra: Problem
    """By the spectra that runs correct."""


def threads() -> Beside:
    """As many as there are cores, but for one that the descent has."""
    return Beside(min(MOST, max(1, len(os.sched_getaffinity(0)) - 1)))


def readied(spec: TuneSpec, own: Problem, pool: Executor, after: Tasks = ()) -> Future[OnArm]:
    """A job's problems; its programs then go on compiling, and who needs one meanwhile waits for that one.

    A program that fails to compile here fails again where it is needed, and is heard of there.

    Args:
        spec: The job.
        own: By spectra, as the descent has it.
        pool: Threads to do it.
        after: What else to do there, when that is done.
    """
    rows = PROPOSED * spec.tune.starts
    # But for what ratios are taken to, which the runs tell: to compile, its shape is enough.
    spectra = spectra_of(spec, own, own.data.reference)

    def ready() -> OnArm:
        runs = problem_of(spec, training(spec, spec.tune.train_seeds), evaluated=True)
        for program in (
            lambda: runs.compile_evaluation(rows),
            *after,
            lambda: spectra.compile_slopes(rows),
        ):
            do(program)
        return OnArm(runs, spectra_of(spec, own, runs.data.reference))

    def do(task: Callable[[], Any]) -> Future[Any]:
        return pool.submit(in_float64(task))  # which is a thread's own

    found = do(ready)
    do(lambda: corrected.compile_ahead(spec, spectra, rows))
    do(lambda: spectra.compile_evaluation(rows))
    return found
