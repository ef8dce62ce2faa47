"""Kernel, scan and stock MJX on a GPU, each at several batch sizes, in one run: `python -m benchmarks.gpu`.

Where the host has several GPUs, the kernel then runs as many controllers on each of the first one, two, four, … as on
one alone (`--scaling`: that only); efficiency is the rate over as many times the rate of one.

An axis-step is one sample of one axis of the linear loop, an arm step one of everything on the arm. Floor: 67
instructions of an axis-step and some 1 600 of an arm step (92 and 2 200 operations, a product and a sum being one
instruction where nothing else needs the product); printed beside each rate is the share of the chip's that so many are.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

AXIS_INSTRUCTIONS, ARM_INSTRUCTIONS = 67, 1600
LANES_OF_A_MULTIPROCESSOR = {"float32": 128, "float64": 64}
BATCH_OF_A_GPU = 131072
SECONDS = {"linear": 10.0, "wam": 4.0, "mjx": 2.7}


def main() -> None:
    """Measure, print, and write down what was found with machine, versions and date."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, dest="out", help="write the results there, as JSON")
    parser.add_argument("--quick", action="store_true", help="one batch size each")
    parser.add_argument("--scaling", action="store_true", help="only how the kernel does on several GPUs")
    args = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.default_backend() != "gpu":
        raise SystemExit("benchmarks.gpu: no GPU here that JAX can use")
    rows = [] if args.scaling else compared(args.quick)
    rows += scaled()
    if args.out:
        said = {
            "device": jax.devices()[0].device_kind,
            "devices": jax.local_device_count(),
            "jax": jax.__version__,
            "date": time.strftime("%Y-%m-%d"),
            "rows": rows,
        }
        args.out.write_text(json.dumps(said, indent=1) + "\n")


def compared(quick: bool) -> list[dict[str, Any]]:
    """Every engine on one GPU."""
    rows = []
    for physics, engine, dtype, batches in (
        ("linear", "kernel", "float32", (131072, 16384)),
        ("linear", "kernel", "float64", (131072,)),
        ("linear", "scan", "float32", (131072, 16384)),
        ("wam", "kernel", "float32", (65536, 16384)),
        ("wam", "kernel", "float64", (65536,)),
        ("wam", "scan", "float32", (65536, 16384)),
        ("mjx", "mjx", "float32", (8192, 2048, 32768, 65536)),
    ):
        for batch in batches[: 1 if quick else None]:
            row = measured(physics, engine, dtype, batch)
            rows.append(row)
            print(
                f"{physics:<7}{engine:<7}{dtype:<9}{batch:>7} controllers: {row['rate'] / 1e9:8.3f} G steps/s, "
                f"{row['share_of_peak']:5.1%} of the instructions, first call {row['first_s']:.0f} s",
                flush=True,
            )
    best = {
        name: max(row["rate"] for row in rows if row["engine"] == name and row["physics"] in ("wam", "mjx"))
        for name in ("kernel", "scan", "mjx")
    }
    print(
        f"arm: kernel / scan {best['kernel'] / best['scan']:.1f}, kernel / stock MJX {best['kernel'] / best['mjx']:.0f}"
    )
    return rows


def scaled() -> list[dict[str, Any]]:
    """The kernel on more and more of the host's GPUs; nothing where there is one."""
    import jax

    there, rows = jax.local_device_count(), []
    counts = [2**i for i in range(there.bit_length()) if there > 1]
    for physics in ("linear", "wam"):
        for devices in counts:
            row = measured(physics, "kernel", "float32", BATCH_OF_A_GPU * devices, devices)
            rows.append(row)
            efficiency = row["rate"] / (devices * rows[-1 - counts.index(devices)]["rate"])
            print(
                f"{physics:<7}kernel, GPUs: {devices}, {BATCH_OF_A_GPU} controllers each: "
                f"{row['rate'] / 1e9:8.3f} G steps/s, efficiency {efficiency:.1%}",
                flush=True,
            )
    return rows


def measured(physics: str, engine: str, dtype: str, batch: int, devices: int = 1) -> dict[str, Any]:
    """Rate of one engine on one batch [steps/s], dealt out to so many GPUs, and how long its first call took [s]."""
    import jax
    import msgspec

    from jaxmpc import Experiment, Params
    from jaxmpc.closed_loops import close_loops
    from jaxmpc.engine.registry import choose
    from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics

    base = Experiment.published("table-1" if physics == "linear" else "table-1-wam")
    short = msgspec.structs.replace(base, duration=SECONDS[physics], settle=1.0)
    experiment = with_physics(short, physics)
    spec, data = program_spec(experiment)._replace(engine=engine), scenario_data(experiment)
    random, text = np.random.default_rng(0), Params.published("text")
    factors = np.exp(random.uniform(-0.7, 0.7, (2, batch)))
    params = text.with_columns({"lam": float(text.lam) * factors[0], "Q_p": float(text.Q_p) * factors[1]})
    mesh = jax.sharding.Mesh(np.array(jax.local_devices()[:devices]), ("device",))
    split = jax.sharding.PartitionSpec("device")

    def dealt(function: Any) -> Any:
        return jax.jit(jax.shard_map(function, mesh=mesh, in_specs=split, out_specs=split, check_vma=False))

    def rms(loops: Any) -> Any:
        return choose(spec).simulate(spec, loops.gains, loops.K2, loops.contacts, data, dtype).metrics.rms

    loops, run = dealt(lambda p: close_loops(p, data.stiffness, data.path))(params), dealt(rms)
    times = []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(run(loops))
        times.append(time.perf_counter() - began)
    axes = 3 if physics == "linear" else 1
    steps = batch * len(experiment.stiffness) * axes * experiment.steps
    instructions = AXIS_INSTRUCTIONS if physics == "linear" else ARM_INSTRUCTIONS
    rate = steps / min(times[1:])
    return {
        "physics": physics,
        "engine": engine,
        "precision": dtype,
        "controllers": batch,
        "devices": devices,
        "rate": rate,
        "first_s": times[0],
        "share_of_peak": rate * instructions / (devices * peak(dtype)),
    }


def peak(dtype: str) -> float:
    """Instructions that the first GPU could issue for its lanes [1/s]: multiprocessors × lanes × clock."""
    import subprocess

    import jax

    asked = ["nvidia-smi", "--query-gpu=clocks.max.sm", "--format=csv,noheader,nounits"]
    megahertz = float(subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()[0])
    return jax.devices()[0].core_count * LANES_OF_A_MULTIPROCESSOR[dtype] * megahertz * 1e6


if __name__ == "__main__":
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    main()
