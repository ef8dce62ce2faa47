"""What a search on the arm comes to after its spectra, made ready beside them: the arm's problem, and its programs.

To compile them takes as long as to descend on the spectra, which waits for nothing of it.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from typing import NamedTuple

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


def readied(
    spec: TuneSpec, own: Problem, pool: Executor, after: Callable[[TuneSpec], Tasks] = lambda _: ()
) -> Future[OnArm]:
    """A job's problems; its programs then go on compiling, and who needs one meanwhile waits for that one.

    A program that fails to compile here fails again where it is needed, and is heard of there.

    Args:
        spec: The job.
        own: By spectra, as the descent has it.
        pool: Threads to do it.
        after: What else to do there, when that is done.
    """
    rows = PROPOSED * spec.tune.starts

    @in_float64  # which is a thread's own
    def ready() -> OnArm:
        runs = problem_of(spec, training(spec, spec.tune.train_seeds), evaluated=True)
        found = OnArm(runs, spectra_of(spec, own, runs.data.reference))
        for program in (
            lambda: found.runs.compile_evaluation(rows),
            lambda: corrected.compile_ahead(spec, found.spectra, rows),
            lambda: found.spectra.compile_evaluation(rows),
            *after(spec),
            lambda: found.spectra.corrected_by_one().compile_slopes(rows),
        ):
            pool.submit(in_float64(program))
        return found

    return pool.submit(ready)
