"""What a search on the arm comes to after its spectra, made ready beside them: the arm's problem, and its programs.

They compile from when their shapes are known, beside the program of the descent, which waits for nothing of it.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future

from jaxmpc.beside import Beside
from jaxmpc.xla.place import platform
from jaxmpc.xla.precision import in_float64
from tuning.job.spec import TuneSpec
from tuning.objective.problem import Problem, problem_of, training
from tuning.search.constraints import Constraints
from tuning.search.mapping import PROPOSED, spectra_of

MOST = 8
"""Programs that compile at a time: of four some wait (`arm-tune`: 63 s on an H200 instead of 54); six do as well."""
Tasks = Sequence[Callable[[], object]]


def threads() -> Beside:
    """As many as there are cores, but for one that the descent has."""
    return Beside(min(MOST, max(1, len(os.sched_getaffinity(0)) - 1)))


def readied(spec: TuneSpec, own: Problem, pool: Executor, after: Callable[[TuneSpec], Tasks]) -> Future[Problem]:
    """A job's problem by runs; the programs of its search go on compiling, and who needs one meanwhile waits for it.

    A program that fails to compile here fails again where it is needed, and is heard of there.

    Args:
        spec: The job.
        own: By spectra, as the descent has it, in shape.
        pool: Threads to do it.
        after: What comes after the search, which begins right behind its programs where that is `early`.
    """
    rows = PROPOSED * spec.tune.starts

    def begun(runs: Problem) -> None:
        spectra = spectra_of(spec, own, runs.data.reference)
        constraints = Constraints(spectra, rows)
        for program in (
            constraints.compile_margins,
            constraints.compile_runs,
            lambda: runs.compile_evaluation(rows),
            lambda: spectra.compile_cells(rows),
        ):
            pool.submit(in_float64(program))
        if early():
            begin(spec, after, pool)

    @in_float64  # which is a thread's own
    def ready() -> Problem:
        return problem_of(spec, training(spec, spec.tune.train_seeds), evaluated=True, begun=begun)

    return pool.submit(ready)


def early() -> bool:
    """Whether what comes after the search compiles before the descent has its programs, or once it has.

    A GPU's programs leave half of 16 cores idle, and freezing compiles for longer than the search takes. On a CPU the
    descent computes on the same cores (`arm-tune` on two of them: 178 s, one run, instead of 152 and 153).
    """
    return platform() != "cpu"


def begin(spec: TuneSpec, after: Callable[[TuneSpec], Tasks], pool: Executor) -> None:
    """Have what comes after the search begin.

    Args:
        spec: The job.
        after: What it comes to.
        pool: Threads to do it, after what they do already.
    """
    pool.submit(in_float64(lambda: [pool.submit(in_float64(task)) for task in after(spec)]))
