"""What the proof of a job on the arm comes to, made ready beside the search: the half of either is compiling."""

from collections.abc import Callable
from functools import partial

from tuning.job.scenarios import scenarios
from tuning.job.spec import TuneSpec
from tuning.objective import comparison
from tuning.proof.flyable import rehearse


def programs(spec: TuneSpec) -> list[Callable[[], None]]:
    """Each compiles something that `tuning.proof.result.assess` will run, if every start reaches its goals."""
    found: list[Callable[[], None]] = [_drawing, partial(rehearse, spec)]
    for seeds, candidates in ((spec.tune.validation_seeds, spec.tune.starts), (spec.tune.heldout_seeds, 1)):
        met = scenarios(spec.experiment, spec.scenarios, seeds)
        pairs = comparison.pairs_of(spec, [spec.space.exact(spec.space.encode(spec.space.base))] * candidates, met)
        found += [partial(comparison.compile_ahead, *pair, spec.engine) for pair in pairs if met]
    return found


def _drawing() -> None:
    import matplotlib.figure  # noqa: F401  # half a second, while nothing is drawn yet
