"""Is a tuned controller's pair of horizons the best of its neighbours, all else polished again?

    python -m benchmarks.horizon_grid SPEC.toml PARAMS.toml [--steps 30]

Every pair H_p ± 4, H_u ± 3 within the bounds is a start of one descent in which the horizons stand still.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from jaxmpc import Params
from jaxmpc.quantities import HORIZONS, HP_MAX, HU_MAX
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec
from tuning.objective.problem import Problem, problem_of, training
from tuning.search.optimise import optimiser
from tuning.search.state import FEASIBLE

AROUND_HP, AROUND_HU = 4, 3
RATE = 0.03


@in_float64
def grid(spec: TuneSpec, tuned: Params, steps: int) -> dict[tuple[int, int], float]:
    """Best score of each pair of horizons in training [-]; ∞ where none held the hard goals."""
    Hp, Hu = int(tuned.Hp), int(tuned.Hu)
    pairs = [
        (p, u)
        for p, u in product(range(Hp - AROUND_HP, Hp + AROUND_HP + 1), range(Hu - AROUND_HU, Hu + AROUND_HU + 1))
        if 2 <= p <= HP_MAX and 1 <= u <= min(p, HU_MAX)
    ]
    problem = problem_of(spec, training(spec, spec.tune.train_seeds))
    z = np.stack([spec.space.encode(tuned.with_columns({"Hp": [p], "Hu": [u]})[0]) for p, u in pairs])
    still = np.array([name in HORIZONS for name in spec.space.names])
    return dict(zip(pairs, polished(problem, z, still, steps), strict=True))


def polished(problem: Problem, z: np.ndarray, still: np.ndarray, steps: int) -> np.ndarray:
    """Best score of each start after so many steps with some of its numbers standing still."""
    begin, update = optimiser()
    memory, best = begin(z), np.full(len(z), np.inf)
    for i in range(steps):
        values = problem.differentiate(z, 1.0)
        held = values.hard.max(axis=1) <= FEASIBLE
        best = np.where(held, np.fmin(best, values.score), best)
        gradient = np.where(still, 0.0, values.gradient)
        moved, memory, _ = update(z, memory, gradient, RATE * (1.0 - i / steps))
        z = np.asarray(moved)
        print(f"{i + 1}/{steps}: best {best.min():.4f}", flush=True)
    return best


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("spec", type=Path)
    parser.add_argument("params", type=Path)
    parser.add_argument("--steps", type=int, default=30)
    args = parser.parse_args()
    use_all_cores()
    spec, tuned = TuneSpec.from_toml(args.spec), Params.from_toml(args.params)
    found = grid(spec, tuned, args.steps)
    own = found[int(tuned.Hp), int(tuned.Hu)]
    for (Hp, Hu), score in sorted(found.items(), key=lambda entry: entry[1]):
        print(f"Hp {Hp:2d}  Hu {Hu:2d}  score {score:.4f}  {100 * (score / own - 1):+.2f} %")
    print(f"the tuned pair is {100 * (own / min(found.values()) - 1):.2f} % above the best of {len(found)}")


if __name__ == "__main__":
    main()
