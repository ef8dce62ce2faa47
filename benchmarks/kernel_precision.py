"""How far RMS in float32 is off on one GPU: `python -m benchmarks.kernel_precision`.

The kernel's against the scan's in float64: text design with λ and Q_p drawn within a factor of two, the published
experiments, of 25 s. Told are every cell by itself (controller x stiffness x axis), and every controller by the worst
of its cells, which ranks it. Beside it how far the scan in float32 is off, which is what chance makes of it, and the
kernel in float64; and how many cells fail otherwise.
"""

import argparse
import os
from typing import Any

import numpy as np

CONTROLLERS = {"linear": 10000, "wam": 1024}
SECONDS = 25.0


def main() -> None:
    """Run them in both worlds and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--physics", nargs="+", choices=list(CONTROLLERS), default=list(CONTROLLERS))
    args = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.default_backend() != "gpu":
        raise SystemExit("benchmarks.kernel_precision: no GPU here that JAX can use")
    for physics in args.physics:
        compared(physics, CONTROLLERS[physics])


def compared(physics: str, batch: int) -> None:
    """Print how far each is off in one world."""
    import jax
    import msgspec

    from jaxmpc import Experiment, Params
    from jaxmpc.closed_loops import close_loops
    from jaxmpc.engine.registry import ENGINES
    from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics

    base = Experiment.published("table-1" if physics == "linear" else "table-1-wam")
    experiment = with_physics(msgspec.structs.replace(base, duration=SECONDS), physics)
    spec, data = program_spec(experiment), scenario_data(experiment)
    text, factors = Params.published("text"), np.random.default_rng(0).uniform(0.5, 2.0, (2, batch))
    params = text.with_columns({"lam": float(text.lam) * factors[0], "Q_p": float(text.Q_p) * factors[1]})
    loops = jax.jit(lambda params: close_loops(params, data.stiffness, data.path))(params)

    def found(engine: str, dtype: str) -> tuple[Any, Any]:
        def run(loops: Any) -> Any:
            cells = ENGINES[engine].simulate(spec, loops.gains, loops.K2, loops.contacts, data, dtype)
            failed = jax.numpy.isfinite(cells.diverged) | jax.numpy.isfinite(cells.over_limit)
            return cells.metrics.rms, failed

        rms, failed = jax.jit(run)(loops)
        return np.asarray(rms, np.float64), np.asarray(failed)

    exact, failed = found("scan", "float64")
    for engine, dtype in (("kernel", "float32"), ("scan", "float32"), ("kernel", "float64")):
        rms, otherwise = found(engine, dtype)
        named = f"{physics:<7}{batch:>6} controllers  {engine:<7}{dtype:<8}"
        for each, one, other in (("cells", rms, exact), ("worst cells", rms.max((1, 2)), exact.max((1, 2)))):
            off = np.abs(one / other - 1.0)[np.isfinite(one) & np.isfinite(other)]
            quantile = np.quantile(off, 0.999)
            said = f"{np.median(off):.1e} in the median, {quantile:.1e} in 99.9 %, {off.max():.1e} at most"
            print(f"{named}{each:<12}off by {said}", flush=True)
        print(f"{named}{np.sum(failed != otherwise)} cells fail otherwise", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    main()
