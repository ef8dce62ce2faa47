"""Gradient autotuning: the residual over tissues and scenarios is minimised, the stability margins are held."""

from pathlib import Path

from jaxmpc.beside import Beside
from jaxmpc.files.alone import alone_in
from jaxmpc.files.errors import check_type
from jaxmpc.xla.precision import in_float64
from tuning.job.risk import Risk
from tuning.job.scenarios import Scenarios
from tuning.job.settings import TuneSettings
from tuning.job.spec import MAKE_SPEC, TuneSpec
from tuning.proof.ahead import programs
from tuning.proof.result import TuneResult, assess, assess_and
from tuning.reports.explained import study
from tuning.reports.figures import before_after_figure, history_figure
from tuning.reports.files import HISTORY, write
from tuning.reports.text import report
from tuning.search.ahead import threads
from tuning.search.front import Front, pareto
from tuning.search.run import run_search

__all__ = [
    "Front",
    "Risk",
    "Scenarios",
    "TuneResult",
    "TuneSettings",
    "TuneSpec",
    "before_after_figure",
    "history_figure",
    "pareto",
    "report",
    "tune",
]


@in_float64
def tune(spec: TuneSpec, folder: str | Path | None = None, progress: bool = False) -> TuneResult:
    """Tune a controller.

    Never raises for goals that nobody can meet: `result.feasible` says so and `result.unmet()` why.

    Args:
        spec: What to tune, on what, with which goals.
        folder: Where results go, and the state from which the same call continues after a kill.
        progress: Whether to show progress on standard error.

    Returns:
        The tuned parameters with the comparison on held-out scenarios.

    Raises:
        InputError: The spec is none, the folder is a file, holds the state of another spec or a damaged one, or another
            process works in it.
    """
    check_type("spec", spec, TuneSpec, MAKE_SPEC)
    place = None if folder is None else Path(folder)
    with alone_in(place), threads() as pool:
        history = run_search(spec, place, progress, programs, pool)
        if place is None:
            return assess(history, progress)
        with Beside(1) as beside:
            way = beside.submit(history_figure, history, place / HISTORY)
            result, explaining = assess_and(study, history, progress)
            write(result, explaining, place, way)
        return result
