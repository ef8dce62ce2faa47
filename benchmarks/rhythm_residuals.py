"""Residual of a controller on the arm over that of the text design, rhythm by rhythm, on unseen motions.

    python -m benchmarks.rhythm_residuals --seeds 9000001 9000011 9000021
    python -m benchmarks.rhythm_residuals --rhythms premature bigeminy --compensation 0.7
    python -m benchmarks.rhythm_residuals --observer 100

A cell is a tissue and an axis of `family-wam`, 20 s after 12 s; the text design runs without compensation.
"""

import argparse
import time
from typing import get_args

import numpy as np
from msgspec.structs import replace

from jaxmpc import Experiment, Params, evaluate
from jaxmpc.files.errors import InputError
from jaxmpc.terminal.arguments import params_from
from tuning.job.scenarios import Rhythm, Scenarios, scenario


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--params", default="family", help="a published set or a file")
    parser.add_argument(
        "--rhythms", nargs="+", default=["premature", "bigeminy", "rate-step"], choices=get_args(Rhythm)
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[9_000_001])
    parser.add_argument("--compensation", type=float, default=0.0, help="share of the friction that it compensates")
    parser.add_argument("--observer", type=float, default=0.0, help="its momentum observer [rad/s]")
    args = parser.parse_args()
    base = Experiment.published("family-wam")
    text = Params.published("text")
    try:
        judged = params_from(args.params)
    except InputError as wrong:
        parser.error(str(wrong))
    for rhythm in args.rhythms:
        for seed in args.seeds:
            began = time.monotonic()
            met = scenario(base, Scenarios(rhythms=(rhythm,)), seed)
            arm = replace(met.arm, compensation=args.compensation, momentum_observer=args.observer)
            own = replace(met, arm=arm)
            theirs, found = evaluate(text, met).metrics, evaluate(judged, own).metrics
            ratio, peaks = np.asarray(found.rms / theirs.rms), np.asarray(found.peak_to_peak / theirs.peak_to_peak)
            each = " / ".join(f"{K:g} N/m {row.max():.2f}" for K, row in zip(met.stiffness, ratio, strict=True))
            print(
                f"{rhythm:<11} seed {seed}: over text at most {np.nanmax(ratio):.3f}, median {np.nanmedian(ratio):.3f},"
                f" peak to peak at most {np.nanmax(peaks):.2f}; {each}; at most {1e3 * np.nanmax(found.rms):.1f} mN,"
                f" |e| {np.nanmax(found.peak_error):.2f} N, chatter {np.nanmax(found.chatter):.2f} m/s²"
                f" ({time.monotonic() - began:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
