"""Controllers that are compared: runs of each on one experiment and on drawn motions that all meet."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmpc import evaluate
from jaxmpc.closed_loops import Outcome
from jaxmpc.experiment import Experiment
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS
from jaxmpc.stability import Margins
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params, by_structure


class Contender(NamedTuple):
    """One of those that are compared."""

    name: str
    params: Params
    origin: str
    """Where it comes from, in words."""
    frozen: Any = None
    """The artifact that it is, a `deploy.controller.artifact.Artifact`; None of parameters alone."""


@dataclass(frozen=True)
class Comparison:
    """What was found.

    Attributes:
        experiment: What all met.
        contenders: In the order given; differences are to the first.
        outcomes: Of the experiment itself, with traces.
        drawn: Metrics on the drawn motions, fields (contenders, seeds, stiffness, 3).
        seeds: What drew these.
        statuses: Statuses there, (contenders, seeds, stiffness).
        known: Margins with the stiffness known, fields (stiffness,); None of one without a schedule.
        ratios: Residual over the least of any linear law, (contenders, stiffness, 3) [-]; None where not asked for.
    """

    experiment: Experiment
    contenders: Sequence[Contender]
    outcomes: Sequence[Outcome]
    drawn: Metrics | None
    known: Sequence[Margins | None]
    ratios: np.ndarray | None = None
    seeds: Sequence[int] = ()
    statuses: np.ndarray | None = None

    def held(self, metric: str) -> np.ndarray | None:
        """A metric on the drawn motions, NaN where a status is not OK, as in trials; None where there are none."""
        if self.drawn is None:
            return None
        values = np.asarray(getattr(self.drawn, metric))
        return values if self.statuses is None else np.where(self.statuses[..., None] == Status.OK, values, np.nan)

    def failures(self) -> Iterator[str]:
        """A line for every contender and tissue on which its runs were not all OK."""
        for c, (one, outcome) in enumerate(zip(self.contenders, self.outcomes, strict=True)):
            for i, stiffness in enumerate(self.experiment.stiffness):
                if (status := Status(int(outcome.status[i]))) != Status.OK:
                    yield f"{one.name}, {stiffness:g} N/m: {status.name}: {status.sentence}"
                if self.statuses is None:
                    continue
                codes = self.statuses[c, :, i]
                for status in map(Status, np.unique(codes[codes != Status.OK]).tolist()):
                    which = np.flatnonzero(codes == status)
                    share = f"{len(which)} of {len(codes)} drawn, first seed {self.seeds[which[0]]}"
                    yield f"{one.name}, {stiffness:g} N/m, {share}: {status.name}: {status.sentence}"


def compared(
    contenders: Sequence[Contender],
    experiment: Experiment,
    seeds: Sequence[int] = (),
    *,
    ratios: np.ndarray | None = None,
    said: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Run all contenders on the experiment and on drawn motions.

    Args:
        contenders: Two or more, or one alone.
        experiment: What they meet.
        seeds: Draw phases, rhythm and noise anew; every contender meets the same.
        ratios: See `Comparison`.
        said: Takes a line of progress.
    """
    said(f"on {experiment.name} itself …")
    own = _run(contenders, experiment, traced=True)
    each = []
    for k, seed in enumerate(seeds):
        said(f"motion {k + 1} of {len(seeds)} (seed {seed}) …")
        each.append([(one.metrics, one.status) for one in _run(contenders, experiment.with_seed(seed), traced=False)])
    drawn = statuses = None
    if each:
        # (seeds, contenders, …) → (contenders, seeds, …)
        stacked = jax.tree.map(lambda *fields: np.stack(fields), *(_stacked(row) for row in each))
        drawn, statuses = jax.tree.map(lambda field: np.swapaxes(field, 0, 1), stacked)
    path = experiment.loop_path()
    known = [known_margins(one.params, experiment.stiffness, path) for one in contenders]
    return Comparison(experiment, contenders, own, drawn, known, ratios, seeds, statuses)


def known_margins(params: Params, stiffness: Sequence[float], path: Any) -> Margins | None:
    """Margins of a family where the stiffness is known, the worst over its band; None without a schedule."""
    if params.listening is None:
        return None
    _, band = judged_where(params.listening)
    found = family_margins(params, stiffness, band, path)
    worst = {name: row.worst(np.asarray(getattr(found, name)), axis=-1) for name, row in MARGINS.items()}
    return Margins(**worst, status=found.status.max(axis=-1))


def _run(contenders: Sequence[Contender], experiment: Experiment, *, traced: bool) -> list[Outcome]:
    """Outcomes in the order of the contenders; those of one structure are one batch."""
    found: dict[int, Outcome] = {}
    for alike in by_structure([one.params for one in contenders]):
        batch = evaluate(Params.stack([contenders[i].params for i in alike]), experiment, trace=traced)
        host = jax.tree.map(np.asarray, batch)
        for k, i in enumerate(alike):
            found[i] = jax.tree.map(lambda leaf, k=k: leaf[k], host)
    return [found[i] for i in range(len(contenders))]


def _stacked(row: Sequence[tuple[Metrics, Any]]) -> Any:
    return jax.tree.map(lambda *fields: np.stack(fields), *row)
