"""Gradient autotuning: the worst residual over tissue, axis and motion is minimised, the stability margins are held."""

from pathlib import Path

from jaxmpc.precision import in_float64
from tuning.optimise import descend
from tuning.report import before_after_figure, history_figure, report
from tuning.result import TuneResult, judge, write
from tuning.spec import Settings, TuneSpec

__all__ = ["Settings", "TuneResult", "TuneSpec", "before_after_figure", "history_figure", "report", "tune"]


@in_float64
def tune(spec: TuneSpec, folder: str | Path | None = None, progress: bool = False) -> TuneResult:
    """Tune a controller.

    Never raises for goals that nobody can meet: `result.feasible` says so and `result.unmet()` why.

    Args:
        spec: What to tune, on what, with which goals.
        folder: Where results go, and the state from which the same call continues after a kill.
        progress: Whether to show progress on standard error.

    Returns:
        The tuned parameters with the comparison on held-out motion seeds.

    Raises:
        InputError: The folder holds the state of another spec, or a damaged one.
    """
    place = None if folder is None else Path(folder)
    if place is not None:
        place.mkdir(parents=True, exist_ok=True)
    result = judge(spec, descend(spec, place, progress))
    if place is not None:
        write(result, place)
    return result
