"""The gradient tuner beside its rivals: `python -m benchmarks.rivals -o DIR`, again to go on where it was stopped.

All minimise the tuner's own objective, log risk and penalties, in the tuner's own room. The rivals are random search,
Optuna's TPE and CMA-ES, each from the given parameters, and once more from what the spectra of the tuner's own run
with the same seed proposed, at its cost; and a PI controller with damping, by a textbook rule and tuned by CMA-ES.

An evaluation simulates scenarios × tissues × samples steps. A look of the tuner counts as evaluations of its starts
times the cost ratio of a gradient, measured here at the same batch; its descent on spectra, which steps no time, as
the evaluations that its wall-clock is worth. Compilation is left out, and reported by itself.
"""

import argparse
from pathlib import Path

from jaxmpc.terminal.process import use_all_cores

REDUCED = Path(__file__).with_name("reduced.toml")
EVALUATIONS, SEEDS = 2000, 5


def main() -> None:
    """Run what has not been run yet, then report."""
    parser = argparse.ArgumentParser(prog="benchmarks.rivals", description=__doc__.partition("\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder of the results")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each tuner")
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help="budget of a rival")
    parser.add_argument("--spec", type=Path, default=REDUCED, help="job, as of `jaxmpc tune`; the reduced one")
    parser.add_argument("--experiment", help="a published experiment instead of the job's")
    args = parser.parse_args()
    from jaxmpc.files.errors import InputError

    use_all_cores()
    try:
        compare(args.out, args.spec, args.experiment, args.seeds, args.evaluations)
    except InputError as error:
        parser.error(str(error))


def compare(out: Path, file: Path, experiment: str | None, seeds: int, evaluations: int) -> None:
    """Everything of one job: the runs that its folder lacks, then table and picture."""
    import msgspec

    from benchmarks.rivals.costs import prepared
    from benchmarks.rivals.record import Run
    from benchmarks.rivals.report import picture, table
    from benchmarks.rivals.runs import GRADIENT, TEXTBOOK, names, run
    from jaxmpc import Experiment
    from jaxmpc.files.sealed import digest, write_atomic
    from tuning import TuneSpec

    spec = TuneSpec.from_toml(file)
    changes = {"tune": msgspec.structs.replace(spec.tune, seed=0)}
    spec = msgspec.structs.replace(spec, **changes)
    if experiment:
        spec = msgspec.structs.replace(spec, experiment=Experiment.published(experiment))
    out.mkdir(parents=True, exist_ok=True)
    key = digest({"spec": spec.to_dict(), "evaluations": evaluations})
    costs = prepared(spec, key, out / "costs.json")
    runs: dict[str, list[Run]] = {name: [] for name in names(spec)}
    for seed in range(seeds):
        for name in runs:
            if name == TEXTBOOK and seed:
                continue
            path = out / f"{name.replace(', ', '-').replace(' + ', '-').lower()}-{seed}.npz"
            if not path.exists():
                proposed = runs[GRADIENT][seed] if name != GRADIENT else None
                run(name, seed, spec, evaluations, costs, proposed).save(path, key)
            runs[name].append(Run.load(path, key))
            done = runs[name][-1]
            print(f"{name}, seed {seed}: {done.best[-1]:.4f} after {done.spent[-1][2]:.0f} s", flush=True)
    text = table(runs, spec, costs)
    print(f"\n{text}")
    write_atomic(out / "report.txt", text.encode())
    picture(runs, spec, out / "rivals.png")


if __name__ == "__main__":
    main()
