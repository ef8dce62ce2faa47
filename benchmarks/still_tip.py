"""In how many trials the heart alone would count as swinging, under a tip that stands still.

    python -m benchmarks.still_tip --trials 10080          # plausible arms; ten times as many take a minute
    python -m benchmarks.still_tip --trials 10080 --hard   # stress arms

Trials count an arm as swinging whose true force above 12 Hz has more than 0.1 N RMS over the last 10 s, whoever moves.
What a heart does there, times the stiffness of its tissue, is what a loop would leave that neither follows nor swings.
"""

import argparse
from collections import Counter

import numpy as np
from scipy.signal import butter, sosfilt

from jaxmpc import Experiment, Params
from jaxmpc.swing import CORNER_HZ, WINDOW
from jaxmpc.world.heart.motion import displacement
from tuning.trials import HARD, NOMINAL, Job, motion_of
from tuning.trials.outcomes import SWINGING


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=2880)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hard", action="store_true", help="stress arms")
    args = parser.parse_args()
    spread = HARD if args.hard else NOMINAL
    job = Job((Params.published("family"),), Experiment.published("table-1-wam"), spread, args.seed)
    met = job.drawn(0, args.trials)
    whose = [motion_of(number) for number in range(args.trials)]
    fast = {number: _fast(job, number) for number in dict.fromkeys(whose)}
    moving = np.array([fast[number] for number in whose])
    swinging = np.any(moving * met.stiffness[:, None] > SWINGING, axis=1)
    print(f"{swinging.sum()} of {args.trials} {spread.arms} arms, {100 * swinging.mean():.2f} %")
    of, all_of = Counter(met.motion[swinging].tolist()), Counter(met.motion.tolist())
    for motion, count in of.most_common():
        print(f"  {motion:<22}{count:6d} of {all_of[motion]}")


def _fast(job: Job, number: int) -> np.ndarray:
    """Motion of a trial's heart above 12 Hz, RMS of each axis at the end [m]."""
    met = job.trial(number)
    t = np.arange(round(met.duration / met.sampling_time)) * met.sampling_time
    sections = butter(4, CORNER_HZ, "highpass", fs=1.0 / met.sampling_time, output="sos")
    fast = sosfilt(sections, displacement(met.motion, t)[0], axis=0)[t >= met.duration - WINDOW]
    found: np.ndarray = np.sqrt(np.mean(fast**2, axis=0))
    return found


if __name__ == "__main__":
    main()
