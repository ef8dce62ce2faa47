"""How much of what a controller leaves on the arm repeats from beat to beat, and so could be known before it comes.

    python -m benchmarks.beat_to_beat --rhythms own rate-step variability --stiffness 1900

A table of the residual over the time since the beat's onset is averaged over past beats, a share of the newest each,
and what it says of the next beat is subtracted. That is what a law would leave that learns the beat, hears its onset at
once and is answered at once: a bound of what is worth building, not a controller. What a family learns itself
(`jaxmpc.law.repetition`) is switched off. 20 s after 12 s, the first quarter learns.
"""

import argparse
from dataclasses import replace
from typing import get_args

import numpy as np

from jaxmpc import Experiment, Params
from jaxmpc.export.golden import simulated_arm_runs
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.world.heart.phase import NOMINAL_CYCLE
from jaxmpc.world.heart.rhythm import beats
from tuning.job.scenarios import Rhythm, Scenarios, scenario

BIN = 2e-3
"""Width of the table's columns [s]."""
LEARNING = 0.25
"""Part of the scored time that only learns [-]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--params", default="family", help="a published set")
    parser.add_argument(
        "--rhythms", nargs="+", default=["own", "rate-step", "variability", "bigeminy"], choices=get_args(Rhythm)
    )
    parser.add_argument("--stiffness", nargs="+", type=float, default=[1900.0], help="of the tissue [N/m]")
    parser.add_argument("--seed", type=int, default=9_000_001)
    parser.add_argument("--share", type=float, default=0.5, help="of the newest beat in the table [-]")
    args = parser.parse_args()
    use_all_cores()
    judged = learning_nothing(Params.published(args.params))
    for rhythm in args.rhythms:
        met = scenario(Experiment.published("family-wam"), Scenarios(rhythms=(rhythm,)), args.seed)
        start = round(met.settle / met.sampling_time)
        for stiffness, run in zip(args.stiffness, simulated_arm_runs(judged, met, tuple(args.stiffness)), strict=True):
            error = (run.force - run.force_ref)[start:]
            onsets = _onsets(met)
            told = expected(error, met.sampling_time * (start + np.arange(len(error))), onsets, args.share)
            scored = slice(round(LEARNING * len(error)), None)
            was, left = _rms(error[scored]), _rms((error - told)[scored])
            each = "  ".join(f"{a:.1f} → {b:.1f} ({b / a:.2f})" for a, b in zip(1e3 * was, 1e3 * left, strict=True))
            print(f"{rhythm:<12}{stiffness:6g} N/m, X Y Z [mN]: {each}", flush=True)


def learning_nothing(params: Params) -> Params:
    """The same controller without what a family learns of the beat itself."""
    if params.listening is None:
        return params
    return replace(params, listening=replace(params.listening, harmonics=0))


def expected(error: np.ndarray, time: np.ndarray, onsets: np.ndarray, share: float) -> np.ndarray:
    """What the beats before tell of each sample, (samples, axes) [N].

    Args:
        error: Residual, (samples, axes) [N].
        time: (samples,) [s].
        onsets: Of the beats, past the last time [s].
        share: Of the newest beat in the table [-].
    """
    beat = np.searchsorted(onsets, time, side="right") - 1
    column = ((time - onsets[beat]) / BIN).astype(int)
    table, told = np.zeros((column.max() + 1, error.shape[1])), np.zeros_like(error)
    for number in np.unique(beat):
        now = beat == number
        told[now] = table[column[now]]
        seen, where = np.unique(column[now], return_inverse=True)
        mean = np.stack([np.bincount(where, each) for each in error[now].T], axis=1) / np.bincount(where)[:, None]
        table[seen] += share * (mean - table[seen])
    return told


def _onsets(met: Experiment) -> np.ndarray:
    if met.motion.kind == "rhythm":
        return beats(met.motion, met.duration + 1.0).onsets
    return np.arange(0.0, met.duration + 1.0, NOMINAL_CYCLE)  # the paper's own heart


def _rms(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


if __name__ == "__main__":
    main()
