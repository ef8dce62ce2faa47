"""What a guard could reach at best on stress arms: the fixed gains, each arm at whichever share of them suits it best.

    python -m benchmarks.constant_gain --trials 1440

A guard has to find while it flies how much of its gain an arm bears. Here each trial is flown at several gains that
stay, and the best of them is taken in hindsight. Whatever leaves 2 N, or swings, at each of them is beyond a guard that
moves the gain alone. Nothing is learned of the tissue, and no sine sounds.
"""

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any
from unittest import mock

import numpy as np

from jaxmpc import Experiment, Params
from jaxmpc.law import gain_backoff
from jaxmpc.law.gain_backoff import BackoffMemory, BackoffState
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.xla import store
from tuning.trials import HARD, NOMINAL, Job, Outcomes, run
from tuning.trials.outcomes import LARGEST_ERROR, SWINGING


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1440)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plausible", action="store_true", help="arms whose cables are stiff")
    parser.add_argument("--gains", nargs="+", type=float, default=[1.0, 0.7, 0.5, 0.35, 0.25, 0.15])
    args = parser.parse_args()
    family = Params.published("family")
    fixed = replace(family, listening=None, knots=())
    base, spread = Experiment.published("table-1-wam"), NOMINAL if args.plausible else HARD
    leaving, swinging = [], []
    for gain in args.gains:
        found = apart(at_gain, Job((fixed,), base, spread, args.seed), args.trials, gain)
        # NaN is of what diverged.
        leaving.append(~np.all(found.peak_error[:, 0] < LARGEST_ERROR, axis=-1))
        swinging.append(~np.all(found.swing[:, 0] <= SWINGING, axis=-1))
        print(f"{gain:5.2f} of the gain: {_shares(leaving[-1], swinging[-1])}", flush=True)
    print(f"at every gain: {_shares(np.all(leaving, axis=0), np.all(swinging, axis=0))}")
    either = np.all(np.logical_or(leaving, swinging), axis=0)
    print(f"one or the other at every gain: {100 * either.mean():.2f} %")
    guarded = apart(run, Job((family,), base, spread, args.seed), args.trials)
    left = np.any(guarded.peak_error[:, 0] >= LARGEST_ERROR, axis=-1)
    print(f"family, with its guard: {_shares(left, guarded.swinging[:, 0])}, lost {100 * guarded.lost.mean():.2f} %")


def apart(what: Callable[..., Outcomes], *arguments: Any) -> Outcomes:
    """In a process of its own: a program that is compiled keeps the gain that it was traced with."""
    with ProcessPoolExecutor(1, get_context("spawn"), use_all_cores) as process:
        return process.submit(what, *arguments).result()


def at_gain(job: Job, count: int, gain: float) -> Outcomes:
    """Trials of a controller whose guard has a gain that stays."""
    begin = gain_backoff.init

    def held(zero: float = 0.0) -> BackoffState:
        return begin(zero)._replace(memory=BackoffMemory(gain + zero, gain + zero, gain + zero))

    store.keep_in(None)  # programs are found by the sources, which say nothing of this gain
    with mock.patch.multiple(gain_backoff, init=held, PACE=0.0, STEADY_PACE=0.0, RETURN=np.inf, PROBE=np.inf):
        return run(job, count)


def _shares(leaving: np.ndarray, swinging: np.ndarray) -> str:
    return f"{100 * leaving.mean():.2f} % leave 2 N, {100 * swinging.mean():.2f} % swing"


if __name__ == "__main__":
    main()
