"""What the proof of a job on the arm comes to, made ready beside the search: the half of either is compiling."""

from collections.abc import Callable
from functools import partial

from jaxmpc.report.loops import curves
from tuning.job.scenarios import scenarios
from tuning.job.spec import TuneSpec
from tuning.objective import comparison
from tuning.proof import flyable, found, split


def programs(spec: TuneSpec) -> list[Callable[[], object]]:
    """Each compiles something that `tuning.proof.result.assess` will run, if every start reaches its goals."""
    # Freezing is the longest: one program after another, the last with what the one before has simulated.
    each: list[Callable[[], object]] = [partial(part.rehearse, spec) for part in (flyable, found, split)]
    each += [partial(curves, spec.space.base, spec.experiment, spec.ideal), _drawing]
    for seeds, candidates in ((spec.tune.validation_seeds, spec.tune.starts), (spec.tune.heldout_seeds, 1)):
        met = scenarios(spec.experiment, spec.scenarios, seeds)
        pairs = comparison.pairs_of(spec, [spec.space.exact(spec.space.encode(spec.space.base))] * candidates, met)
        each += [partial(comparison.compile_ahead, spec, *pair) for pair in pairs if met]
    return each


def _drawing() -> None:
    import matplotlib.figure  # noqa: F401  # half a second, while nothing is drawn yet
