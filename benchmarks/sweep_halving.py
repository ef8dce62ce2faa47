"""Successive halving beside the full grid, three specs of 10⁴ rows each: `python -m benchmarks.sweep_halving`.

Ten seconds of the published experiment on three tissues, in contact from the start; its first stage is 1.6 s long, of
which one heartbeat is scored. Told are the best row that each finds, the steps that halving takes of all steps, and
the processor time of both; what the first of them compiles is in it.
"""

import argparse
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.sweep_overhead import taken
from benchmarks.sweep_throughput import machine
from jaxmpc.terminal.process import use_all_cores

ROWS, CORES = 10_000, 2
BASE: dict[str, Any] = {
    "experiment": {
        "published": "table-1",
        "damping": "sampled",
        "duration": 10.0,
        "settle": 2.0,
        "reference": {"z": -5.0},
    },
    "params": {"published": "cautious"},
}
SPECS: dict[str, dict[str, Any]] = {
    "grid, true residual": {
        "kind": "grid",
        "best": "true_rms",
        "axes": {"lam": {"log": [0.005, 2.0], "points": 100}, "Q_p": {"log": [0.02, 3.0], "points": 100}},
    },
    "random, residual": {
        "kind": "random",
        "rows": ROWS,
        "seed": 1,
        "axes": {"lam": {"log": [0.01, 1.0]}, "T_cl": {"log": [0.001, 0.01]}, "Q_p": {"log": [0.1, 1.0]}},
    },
    "Sobol, peak to peak, chatter bounded": {
        "kind": "sobol",
        "rows": ROWS,
        "seed": 1,
        "best": "peak_to_peak",
        "constraints": {"M_s": 2.0, "chatter": 1.0},
        "axes": {"lam": {"log": [0.01, 2.0]}, "Q_p": {"log": [0.02, 3.0]}, "Khat_s": {"log": [300.0, 3000.0]}},
    },
}
REFINE = {"method": "halving", "stages": [{"keep": 300, "experiment": {"duration": 1.6, "settle": 0.6}}]}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args()
    use_all_cores(CORES)
    print(f"{machine()}, of which {CORES} are used; linear loop, 10 s, {ROWS} rows", flush=True)
    for name, table in SPECS.items():
        print(f"{name}: {compared(table)}", flush=True)


def compared(table: dict[str, Any]) -> str:
    """Halving and the full grid of one table, for people."""
    from sweeps.refine.run import run as run_refined
    from sweeps.result import Result
    from sweeps.run import run
    from sweeps.spec import SweepSpec

    spec = SweepSpec.from_dict({**BASE, "sweep": table, "refine": REFINE})
    with tempfile.TemporaryDirectory() as folder:
        half, full = Path(folder) / "half", Path(folder) / "full"
        quick = taken(partial(run_refined, spec, half))
        slow = taken(partial(run, replace(spec, refine=None), full))
        found, expected = Result.load(half), Result.load(full)
    share = sum(steps(result) for _, result in found.stages) / steps(expected)
    mine, best = found.best(1), expected.best(1)
    same = "the same best row" if mine["row"].tolist() == best["row"].tolist() else f"NOT row {best['row'].tolist()}"
    rank = list(expected.ranked()).index(expected.place(int(mine["row"][0]))) + 1 if len(mine) else None
    return (
        f"{len(expected)} rows, row {mine['row'].tolist()}, {same} (rank {rank} of all), in {share:.3f} of the steps,"
        f" {quick.processor:.1f} s of processor time instead of {slow.processor:.1f} s"
    )


def steps(result: Any) -> int:
    """Steps of all tissues that a result took."""
    experiment = result.plan.canonical["experiment"]
    return len(result) * len(result.plan.stiffness) * round(experiment["duration"] / experiment["sampling_time"])


if __name__ == "__main__":
    main()
