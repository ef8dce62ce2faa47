"""What tangents in the kernel cost beside its run, on one GPU: `python -m benchmarks.kernel_tangents`.

Rows are the run alone, one tangent of the RMS with it, and its gradient by eight parameters: eight tangents, so many to
a program as its shape says (lanes x warps x directions). `--scan` adds the gradient in reverse mode through the scan,
which holds what a loop carries at every sample: 512 controllers of the arm are 3 GB. Design is not in the figures: its
tangents are made before. `--check` holds the gradient in float32 against central differences in float64, without counts
and saturation, whose slope is straight-through on purpose.
"""

import argparse
import json
import os
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

NAMES = ("lam", "delta", "Q_p", "Q_x", "T_cl", "K2", "Khat_s", "R")
SECONDS = {"linear": 10.0, "wam": 4.0}
SHAPES = {"linear": ("64x1x1", "32x1x4"), "wam": ("256x8x2",)}
"""With more directions a program the registers do not suffice."""


def main() -> None:
    """Measure, print, and write down what was found with machine, versions and date."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, dest="out", help="write the results there, as JSON")
    parser.add_argument("--physics", nargs="+", choices=list(SECONDS), default=list(SECONDS))
    parser.add_argument("--shapes", nargs="+", metavar="LANESxWARPSxDIRECTIONS", help="of the kernel with tangents")
    parser.add_argument("--controllers", type=int, nargs="+", help="how many, times three stiffnesses")
    parser.add_argument(
        "--all", action="store_true", dest="all_metrics", help="slopes of all metrics, not the RMS alone"
    )
    parser.add_argument("--scan", action="store_true", help="the reverse mode through the scan too; few controllers")
    parser.add_argument("--check", action="store_true", help="the gradient against differences in float64 too")
    args = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.default_backend() != "gpu":
        raise SystemExit("benchmarks.kernel_tangents: no GPU here that JAX can use")
    rows: list[dict[str, Any]] = []
    for physics in args.physics:
        for batch in args.controllers or (32768,):
            rows += compared(physics, batch, args.shapes or SHAPES[physics], args.scan, args.all_metrics)
        if args.check:
            checked(physics)
    if args.out:
        device = jax.devices()[0].device_kind
        said = {"device": device, "jax": jax.__version__, "date": time.strftime("%Y-%m-%d"), "rows": rows}
        args.out.write_text(json.dumps(said, indent=1) + "\n")


def compared(physics: str, batch: int, shapes: Any, with_scan: bool, all_metrics: bool) -> list[dict[str, Any]]:
    """Rows of one world and batch size, each printed when it is there; what fails is told and left out."""
    import jax
    import msgspec

    from jaxmpc import Experiment
    from jaxmpc.engine import kernel
    from jaxmpc.engine.registry import ENGINES
    from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics

    base = Experiment.published("table-1" if physics == "linear" else "table-1-wam")
    short = msgspec.structs.replace(base, duration=SECONDS[physics], settle=1.0)
    experiment = with_physics(short, physics)
    whole, data = program_spec(experiment), scenario_data(experiment)
    spec = whole._replace(slopes=None if all_metrics else ("rms",))
    loops, along = controllers(batch, data)

    def rms(name: str, loops: Any) -> Any:
        return ENGINES[name].simulate(spec, loops.gains, loops.K2, loops.contacts, data, "float32").metrics.rms

    def one(loops: Any, along: Any) -> Any:
        return jax.jvp(lambda loops: rms("kernel", loops), (loops,), (jax.tree.map(lambda leaf: leaf[1], along),))

    def eight(loops: Any, along: Any) -> Any:
        def push(direction: Any) -> Any:
            return jax.jvp(lambda loops: rms("kernel", loops), (loops,), (direction,))

        return jax.vmap(push, out_axes=(None, 0))(along)

    def reverse(loops: Any, along: Any) -> Any:
        """As a tuner has it: one number, its slope along all parameters."""
        slope = jax.grad(lambda loops: rms("scan", loops).sum())(loops)
        return sum(
            (leaf * tangent).sum(axis=range(1, tangent.ndim))
            for leaf, tangent in zip(jax.tree.leaves(slope), jax.tree.leaves(along), strict=True)
        )

    found: list[dict[str, Any]] = []

    def row(what: str, shape: str, function: Callable[..., Any], *arguments: Any) -> None:
        """Measured beside the first row that succeeded."""
        try:
            first, best = seconds(jax.jit(function), *arguments)
        except Exception:
            print(f"{physics:<7}{batch:>7} controllers  {what:<18}{shape:<9} failed:", flush=True)
            traceback.print_exc(limit=-4)
            return
        found.append(
            {"physics": physics, "controllers": batch, "what": what, "shape": shape, "s": best, "first_s": first}
        )
        ratio = best / found[0]["s"] if found[0]["what"] == "run" else float("nan")
        line = f"{physics:<7}{batch:>7} controllers  {what:<18}{shape:<9}{1e3 * best:9.2f} ms {ratio:7.2f} x the run"
        print(f"{line}, first call {first:.0f} s", flush=True)

    row("run", "", lambda loops: rms("kernel", loops), loops)
    name = "AXIS_ALONG" if physics == "linear" else "ARM_ALONG"
    usual = getattr(kernel, name)
    told = set()
    for text in shapes:
        lanes, warps, directions = map(int, text.split("x"))
        if (lanes, warps) not in told:
            told.add((lanes, warps))
            setattr(kernel, name, usual._replace(lanes=lanes, warps=warps, directions=1))
            row("one tangent", f"{lanes}x{warps}", lambda *given: one(*given), loops, along)
        setattr(kernel, name, usual._replace(lanes=lanes, warps=warps, directions=directions))
        row("eight tangents", text, lambda *given: eight(*given), loops, along)
    setattr(kernel, name, usual)
    if with_scan:
        row("run, scan", "", lambda loops: rms("scan", loops), loops)
        row("reverse, scan", "", reverse, loops, along)
    return found


def checked(physics: str, batch: int = 256, step: float = 1e-4) -> None:
    """Say how far the gradient of the mean RMS is off, each controller's by its largest component."""
    import jax
    import msgspec

    from jaxmpc import Experiment
    from jaxmpc.engine.registry import ENGINES
    from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics

    base = Experiment.published("table-1" if physics == "linear" else "table-1-wam")
    none = (0.0,) * 4
    arm = {"encoder_counts": 0, "torque_lsb": 0.0, "torque_limit": (200.0,) * 4}
    arm |= {"joint_torque_limit": none, "torque_step_limit": none}
    quiet: dict[str, Any] = {"arm": msgspec.structs.replace(base.arm, **arm)} if physics == "wam" else {}
    sensor = msgspec.structs.replace(base.sensor, lsb=(0.0, 0.0, 0.0))
    short = msgspec.structs.replace(base, duration=SECONDS[physics], settle=1.0, sensor=sensor, **quiet)
    experiment = with_physics(short, physics)
    spec, data = program_spec(experiment), scenario_data(experiment)
    closed, logs = drawn(batch, data)

    def mean(logs: Any, dtype: str) -> Any:
        loops = closed(logs)
        found = ENGINES["kernel"].simulate(spec, loops.gains, loops.K2, loops.contacts, data, dtype)
        return found.metrics.rms.mean(axis=(1, 2))

    def slope(logs: Any, direction: Any) -> Any:
        return jax.jvp(lambda logs: mean(logs, "float32"), (logs,), (direction,))[1]

    try:
        found = np.asarray(jax.jit(jax.vmap(slope, in_axes=(None, 0)))(logs, directions(batch)), float)
        exact = jax.jit(lambda logs: mean(logs, "float64"))
        wanted = np.stack(
            [
                np.asarray((exact(logs + step * row) - exact(logs - step * row)) / (2.0 * step))
                for row in directions(batch)
            ]
        )
    except Exception:
        print(f"{physics:<7}check failed:", flush=True)
        traceback.print_exc(limit=-4)
        return
    off = np.abs(found - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    median, most = np.median(off), off.max()
    print(
        f"{physics:<7}gradient, float32, off by {median:.1e} in the median, {most:.1e} at most of {batch}", flush=True
    )


def drawn(batch: int, data: Any) -> tuple[Callable[[Any], Any], Any]:
    """Closed loops by the logarithms of the parameters, and these of a batch, (parameters, batch); traceable."""
    import dataclasses

    import jax
    import jax.numpy as jnp

    from jaxmpc import Params
    from jaxmpc.closed_loops import close_loops

    random, text = np.random.default_rng(0), Params.published("text")
    values = np.stack([np.full(batch, float(getattr(text, name))) for name in NAMES])

    def closed(logs: Any) -> Any:
        params = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (batch, *jnp.shape(leaf))), text)
        params = dataclasses.replace(params, **dict(zip(NAMES, jnp.exp(logs), strict=True)))
        return close_loops(params, data.stiffness, data.path)

    return closed, jnp.log(values * np.exp(random.uniform(-0.1, 0.1, values.shape)))


def directions(batch: int) -> Any:
    """One parameter of all controllers each, (parameters, parameters, batch)."""
    import jax.numpy as jnp

    return jnp.broadcast_to(jnp.eye(len(NAMES))[:, :, None], (len(NAMES), len(NAMES), batch))


def controllers(batch: int, data: Any) -> tuple[Any, Any]:
    """Closed loops of a batch, and their tangents by the logarithm of each of eight parameters, these in front."""
    import jax

    closed, logs = drawn(batch, data)

    def pushed(direction: Any) -> Any:
        return jax.jvp(closed, (logs,), (direction,))

    both: tuple[Any, Any] = jax.jit(jax.vmap(pushed, out_axes=(None, 0)))(directions(batch))
    return both


def seconds(function: Callable[..., Any], *arguments: Any) -> tuple[float, float]:
    """How long the first call took, and the best of those after it [s]."""
    import jax

    times = []
    for _ in range(4):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - began)
    return times[0], min(times[1:])


if __name__ == "__main__":
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    main()
