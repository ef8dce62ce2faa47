"""`jaxmpc freeze`: parameters → a sealed controller for the robot."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deploy.artifact import Artifact
    from jaxmpc.experiment import Experiment
    from jaxmpc.params import Params

STIFFNESSES = 33
"""Between the softest and the hardest tissue, log-spaced, besides the experiment's own."""
GOLDEN_FROM, GOLDEN_SAMPLES = 2.0, 256
"""Start [s] and length [samples] of the golden trace: the ramp's end, with the heart already moving."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("params", help="a params.toml, or a published set: text, printed")
    parser.add_argument("-o", "--output", type=Path, default=Path("controller.npz"), help="(controller.npz)")
    parser.add_argument("--experiment", default="table-1", help="its stiffnesses are the promise (table-1)")
    parser.add_argument("--ideal", action="store_true", help="declare the margins of the ideal loop, not as it runs")
    floor = parser.add_argument_group("margin floor, held at every stiffness from softest to hardest")
    floor.add_argument("--max-ms", type=float, default=2.0, metavar="M_S", help="highest peak sensitivity (2.0)")
    floor.add_argument("--min-gain-db", type=float, metavar="DB", help="lowest gain margin upwards")
    floor.add_argument("--min-reduction-db", type=float, metavar="DB", help="lowest gain margin downwards")
    floor.add_argument("--min-phase-deg", type=float, metavar="DEG", help="lowest phase margin")
    floor.add_argument("--min-delay-ms", type=float, metavar="MS", help="lowest delay margin")


def run(args: argparse.Namespace) -> int:
    """Design, judge, freeze; an unstable controller or one below its floor is refused with exit code 2."""
    from jaxmpc.cli.arguments import experiment_from, params_from
    from jaxmpc.cli.setup import use_all_cores

    use_all_cores()
    given = {
        "M_s": args.max_ms,
        "gain_margin_db": args.min_gain_db,
        "gain_reduction_db": args.min_reduction_db,
        "phase_margin_deg": args.min_phase_deg,
        "delay_margin_s": None if args.min_delay_ms is None else 1e-3 * args.min_delay_ms,
    }
    floor = {name: value for name, value in given.items() if value is not None}
    params, experiment = params_from(args.params), experiment_from(args.experiment)
    artifact = freeze_controller(args.output, params, experiment, floor, ideal=args.ideal)
    loop = "ideal loop" if args.ideal else "loop as it runs"
    worst = max(row["M_s"] for row in artifact.margins)
    print(f"frozen: {args.output} ({args.output.stat().st_size} bytes), K_s {len(artifact.margins)} values, {loop}")
    print(f"worst M_s {worst:.3f}, floor {artifact.floor}")
    print(f"`jaxmpc check {args.output}` replays it anywhere")
    return 0


def freeze_controller(
    path: Path, params: "Params", experiment: "Experiment", floor: dict[str, float], *, ideal: bool
) -> "Artifact":
    """Connect design, margins and simulation to the robot-side `deploy.freeze`, which takes plain arrays.

    Args:
        path: Where to.
        params: One controller.
        experiment: Its stiffnesses, sampling and delay are what is promised; its run is the golden trace.
        floor: Margins to be kept at every stiffness.
        ideal: Whether the declared margins are those of the ideal loop.

    Raises:
        InputError: The controller is unstable or below its floor; nothing has been written.
    """
    import numpy as np

    from deploy.freeze import freeze
    from jaxmpc import __version__, design, margins
    from jaxmpc.errors import InputError
    from jaxmpc.golden import law_trace, simulated_run
    from jaxmpc.sealed import digest

    between = np.geomspace(min(experiment.stiffness), max(experiment.stiffness), STIFFNESSES)
    stiffness = np.unique([*experiment.stiffness, *between])
    found = margins(params, stiffness, delay=experiment.delay, ideal=ideal, timing=experiment.timing)
    rows: list[dict[str, Any]] = []
    for i, K_s in enumerate(stiffness.tolist()):
        row = {name: float(getattr(found, name)[i]) for name in found._fields if name != "status"}
        if not row["spectral_radius"] < 1.0:
            remedy = "Tune it over this stiffness, or promise a narrower set."
            raise InputError("spectral radius", f"{row['spectral_radius']:.4f} at {K_s:.4g} N/m", "below 1", remedy)
        rows.append({"stiffness": K_s, "delay": experiment.delay, "ideal": ideal, **row})

    preview = experiment.reference.preview
    first = min(round(GOLDEN_FROM / experiment.sampling_time), max(experiment.steps - GOLDEN_SAMPLES, 0))
    force, wanted = (signal[first : first + GOLDEN_SAMPLES] for signal in simulated_run(params, experiment))
    gains = design(params, experiment.timing)
    v = law_trace(gains, force, wanted, preview)
    provenance = {
        "jaxmpc": __version__,
        "experiment": experiment.name,
        "experiment_sha256": digest(experiment.to_dict()),
    }
    return freeze(
        path,
        gains,
        experiment.sampling_time,
        float(params.K2),
        params.to_dict(),
        rows,
        floor,
        (force, wanted, v),
        provenance,
        preview,
    )
