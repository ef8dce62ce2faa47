"""Trials on tissue that changes under way: how many leave |e| < 2 N, beside tissue that stays.

    python -m benchmarks.changing_tissue --trials 1440            # two cores: some 16 trials a second and column
    python -m benchmarks.changing_tissue --changes stiffer-4 softer-4 --params family
    python -m benchmarks.changing_tissue --changes contact-loss   # the tip leaves the tissue and meets it again

Arms, rhythms and motions are those of `jaxmpc trials`, the stiffness log-uniform where both ends of the change stay
within 300–2200 N/m. A trial that stays and the one that changes differ in nothing else, so that it is told how many
leave on neither of the two tissues that stay.
"""

import argparse
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.stats import binomtest

from jaxmpc import Experiment, Params, Status
from jaxmpc.experiment.tables import Change
from tuning.trials import Job, Outcomes, run
from tuning.trials.drawn import STIFFNESS
from tuning.trials.outcomes import LARGEST_ERROR

AT = 12.0
"""When the change begins [s]: a family has found the tissue, and learned what is usual on it."""


class Kind(NamedTuple):
    factor: float
    """Stiffness after over stiffness before [-]."""
    seconds: float


STAYS = Kind(1.0, 0.2)
CONTACT_LOSS = "contact-loss"
KINDS = {
    "stiffer-4": Kind(4.0, 0.2),
    "softer-4": Kind(0.25, 0.2),
    "stiffer-3-slowly": Kind(3.0, 8.0),
    "stiffer-2": Kind(2.0, 0.2),
    "softer-2-slowly": Kind(0.5, 10.0),
}


@dataclass(frozen=True)
class Changing(Job):
    """Trials whose tissue has its stiffness times `begins` until it changes to `ends` times."""

    kind: Kind = STAYS
    begins: float = 1.0
    ends: float = 1.0

    def trial(self, number: int) -> Experiment:
        drawn = super().trial(number)
        # The share of the way from lowest to highest that a trial has, on the narrower way.
        low, high = np.log(STIFFNESS)
        share = (np.log(drawn.stiffness[0]) - low) / (high - low)
        low, high = low - min(np.log(self.kind.factor), 0.0), high - max(np.log(self.kind.factor), 0.0)
        begins = float(np.exp(low + share * (high - low))) * self.begins
        change = Change(AT, self.ends / self.begins, self.kind.seconds)
        return replace(drawn, stiffness=(begins,), tissue=replace(drawn.tissue, changes=(change,)))


def columns(kind: Kind) -> dict[str, tuple[float, float]]:
    """Factors on the stiffness before and after."""
    return {"changing": (1.0, kind.factor), "before": (1.0, 1.0), "after": (kind.factor, kind.factor)}


def left(found: Outcomes, controller: int) -> np.ndarray:
    """Whether each trial left |e| < 2 N, or ended otherwise than it was to."""
    peak = np.nan_to_num(found.peak_error[:, controller].max(axis=-1), nan=np.inf)
    well = np.isin(found.status[:, controller], (Status.OK, Status.LOST_CONTACT))
    gone: np.ndarray = (peak >= LARGEST_ERROR) | ~well
    return gone


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1440)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--params", nargs="+", default=["family"], help="published sets")
    parser.add_argument("--changes", nargs="+", default=list(KINDS), choices=[*KINDS, CONTACT_LOSS])
    parser.add_argument("--columns", nargs="+", default=["changing", "before", "after"], help="which trials")
    args = parser.parse_args()
    controllers = tuple(map(Params.published, args.params))
    base = Experiment.published("table-1-wam")
    for name in args.changes:
        if name == CONTACT_LOSS:
            jobs: dict[str, Job] = {"changing": Job(controllers, Experiment.published(CONTACT_LOSS), seed=args.seed)}
        else:
            kind = KINDS[name]
            jobs = {
                column: Changing(controllers, base, seed=args.seed, kind=kind, begins=begins, ends=ends)
                for column, (begins, ends) in columns(kind).items()
                if column in args.columns
            }
        gone_in: dict[tuple[str, str], np.ndarray] = {}
        for column, job in jobs.items():
            began = time.monotonic()
            found = run(job, args.trials)
            for c, controller in enumerate(args.params):
                gone_in[column, controller] = left(found, c)
                gone = int(gone_in[column, controller].sum())
                low, high = binomtest(gone, args.trials).proportion_ci(method="wilson")
                median = np.nanmedian(found.peak_error[:, c].max(axis=-1))
                print(
                    f"{name:<17} {column:<9} {controller:<9} left 2 N {gone} of {args.trials}"
                    f" ({100 * low:.2f}–{100 * high:.2f} %), lost {int(found.lost[:, c].sum())},"
                    f" swinging {int(found.swinging[:, c].sum())}, median largest |e| {median:.2f} N"
                    f" ({time.monotonic() - began:.0f} s)",
                    flush=True,
                )
        for controller in args.params:
            if all((column, controller) in gone_in for column in columns(STAYS)):
                changing, *stays = (gone_in[column, controller] for column in columns(STAYS))
                alone = int((changing & ~np.logical_or(*stays)).sum())
                print(f"{name:<17} {controller}: {alone} left 2 N that do so on neither tissue that stays", flush=True)


if __name__ == "__main__":
    main()
