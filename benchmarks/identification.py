"""How well a family knows the tissue six seconds after full contact, on random arms.

    python -m benchmarks.identification --trials 10080        # two cores: some 20 trials a second

Arms have masses ±10 %, friction ±30 %, every rhythm, 300–2200 N/m and the sensor's noise; the wanted force is −5 N,
reached at 2.5 s. An axis *knows* where the schedule has half of the control and more, *rightly* while K̂ is within 8 %
of the truth; its interval is *wrong* where the truth lies outside the family's band about K̂. Told are trials on all of
whose axes that is so, or on any of whose axes an interval is wrong, at that moment and ever before.
"""

import argparse
import time
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from msgspec.structs import replace
from scipy.stats import binomtest

from jaxmpc import Experiment, Params
from jaxmpc.closed_loops import run_loops
from jaxmpc.engine.base import ProgramSpec
from jaxmpc.engine.scenario import program_spec
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.blocks import OverBlocks
from jaxmpc.xla.precision import in_float64
from tuning.job.scenarios import Rhythm, Scenarios
from tuning.trials.compute import constants_of, met_in_block
from tuning.trials.drawn import BLOCK, POOL, STIFFNESS, Job, Spread
from tuning.trials.program import Met, Shared, scene_of

FULL_CONTACT, HEARD_FOR = 2.5, 6.0
"""When −5 N is wanted, and how much later the tissue is to be known [s]."""
RIGHT = 0.08
"""Largest relative error of K̂ that is asked for [-]."""
ARMS = Spread(STIFFNESS, Scenarios(rhythms=get_args(Rhythm), friction=0.3, mass=0.1, delays=(1,)), arms="random")


class Listening(Job):
    """Trials that end when the tissue is to be known."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "base", replace(self.base, duration=FULL_CONTACT + HEARD_FOR))


class Heard(NamedTuple):
    """Of every trial and axis, (motions, copies, 3)."""

    off: Any
    """K̂ over the truth, less one, at the end [-]."""
    authority: Any
    """Share of the control that the schedule has then [-]."""
    farthest: Any
    """Largest |K̂ over the truth − 1| while an axis knew; 0 where it never did [-]."""


def heard(met: Met, shared: Shared, *, spec: ProgramSpec, varied: tuple[int, ...], structure: Any) -> Heard:
    """Run all arms on one motion, of which alone samples are kept; traceable."""
    loops, data, _ = scene_of(met, shared, varied, structure)
    trace: Any = run_loops(loops, data, world=spec, dtype="float64", traced=True).trace
    # (controllers, copies, 3, steps)
    off = trace.stiffness[0] / data.stiffness[0, :, None, None] - 1.0
    authority = trace.authority[0]
    farthest = jnp.max(jnp.where(authority >= 0.5, abs(off), 0.0), axis=-1)
    return Heard(off[None, ..., -1], authority[None, ..., -1], farthest[None])


@in_float64
def listen(job: Job, trials: int) -> Heard:
    """Every trial of a job, each field (trials, 3)."""
    constants, base = constants_of(job), job.trial(0)
    static = {"spec": program_spec(base), "varied": constants.varied, "structure": constants.structure}
    run = OverBlocks(heard, 1, static)
    shared = Shared(
        Params.stack(job.controllers), constants.robot, constants.signals, base.loop_path(), base.force_limit
    )
    parts = []
    with progress("listen", trials, "trials", True) as tick:
        for first in range(0, trials, BLOCK):
            parts.append(run(met_in_block(job, constants.varied, first), shared))
            tick(min(first + BLOCK, trials), "")
    whole: Heard = jax.tree.map(lambda *fields: np.concatenate(fields).reshape(-1, 3), *parts)
    return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10 * BLOCK, help=f"in blocks of {BLOCK}, {POOL} motions in each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--params", default="family", help="a published set")
    args = parser.parse_args()
    use_all_cores()
    params, began = Params.published(args.params), time.monotonic()
    assert params.listening is not None, f"{args.params} finds no stiffness"
    found = listen(Listening((params,), Experiment.published("table-1-wam"), ARMS, args.seed), args.trials)
    count, band = len(found.off), float(params.listening.band)
    known = found.authority >= 0.5
    for what, each in (
        ("known on all axes", known.all(axis=1)),
        (f"known on all axes within {RIGHT:.0%}", (known & (abs(found.off) <= RIGHT)).all(axis=1)),
        ("the safe law on some axis", (~known).any(axis=1)),
        (f"an interval wrong then (beyond {band:.0%})", (known & (abs(found.off) > band)).any(axis=1)),
        (f"an interval wrong then or before (beyond {band:.0%})", (found.farthest > band).any(axis=1)),
    ):
        low, high = binomtest(int(each.sum()), count).proportion_ci(method="wilson")
        print(f"{what:<52} {each.sum():>6} of {count}, {each.mean():8.3%} ({low:.3%}–{high:.3%})")
    print(f"largest |K̂/K_s − 1| known: {abs(found.off)[known].max():.3f}; {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
