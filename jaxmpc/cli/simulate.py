"""`jaxmpc simulate`: one experiment, its tables, its figures and, on the arm, its film."""

import argparse
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.beside import Beside
from jaxmpc.terminal.arguments import engine_argument
from jaxmpc.terminal.progress import said_after

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome
    from jaxmpc.experiment import Experiment
    from jaxmpc.synthesis.params import Params

SHORTEST = 1.0
"""Record of a disturbance whose spectrum says something [s]."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "experiment", help="a TOML file, or a published one: table-1, figure-3, table-1-wam, figure-3-wam, …"
    )
    parser.add_argument(
        "--params",
        default="text",
        help="a params.toml, or a published set: text, printed, mpc-alone, cautious, family (text)",
    )
    parser.add_argument("--physics", choices=("linear", "wam", "mjx"), help="contact loop, arm, or arm on stock MJX")
    engine_argument(parser)
    parser.add_argument("--compare", action="store_true", help="also run the AOB alone and the MPC alone")
    parser.add_argument(
        "--video", nargs="?", const="", metavar="FILE.mp4", help="film of the arm (NAME.mp4 beside the figures)"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder for the figures (runs/NAME-PARAMS)")


def run(args: argparse.Namespace) -> int:
    """Simulate, print, draw; 1 when a stiffness did not end OK."""
    from jaxmpc.files.outputs import check_folder
    from jaxmpc.terminal.arguments import experiment_from, params_from
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    from jaxmpc import Status
    from jaxmpc.cli import comparison
    from jaxmpc.engine.registry import named
    from jaxmpc.engine.scenario import program_spec
    from jaxmpc.pictures.film import check_film, film

    params, experiment = params_from(args.params), _with_physics(experiment_from(args.experiment), args.physics)
    folder: Path = args.output or Path("runs") / f"{experiment.name}-{_label(args.params, params)}"
    check_folder("-o", folder)
    named(program_spec(experiment), args.engine, traced=True)
    others = comparison.parts(params) if args.compare else {}
    filmed = None
    if args.video is not None:
        filmed = Path(args.video) if args.video else folder / f"{experiment.name}.mp4"
        check_folder("--video", filmed.parent)
        check_film(filmed, experiment)
    print(
        f"experiment {experiment.name}: {experiment.duration:g} s, physics {experiment.physics}, "
        f"damping {_damping(experiment)}, params {args.params}"
    )
    outcome, still = with_heart_still(params, experiment)
    compared = {label: simulated(other, experiment) for label, other in others.items()}
    _tables(params.architecture, outcome, compared, experiment)
    row = _figures(folder, experiment, _label(args.params, params), outcome, still)
    if filmed and row is not None:
        film(filmed, experiment, outcome, row)
        print(f"film: {filmed}")
    _statuses("", outcome, experiment)
    for label, other in compared.items():
        _statuses(f"{label}, ", other, experiment)
    return int(any(int(code) != Status.OK for code in outcome.status))


def _label(given: str, params: "Params") -> str:
    """What a parameter set is called beside others: its published name, or its file's with the start of its hash."""
    from jaxmpc.files.sealed import digest
    from jaxmpc.synthesis.published import PUBLISHED

    return given if given in PUBLISHED else f"{Path(given).stem}-{digest(params.to_dict())[:6]}"


def simulated(params: "Params", experiment: "Experiment", traced: bool = False) -> "Outcome":
    """`evaluate` that waits for the result, as numpy, and says after a while that there is something to wait for."""
    from jaxmpc import evaluate

    with said_after(_compiling(params, experiment)):
        return _on_host(evaluate(params, experiment, trace=traced))


def with_heart_still(params: "Params", experiment: "Experiment") -> tuple["Outcome", "Outcome"]:
    """What `simulated` finds, every sample kept, and the same without motion (itself where there is none)."""
    from jaxmpc import evaluate

    if experiment.motion.kind == "none":
        outcome = simulated(params, experiment, traced=True)
        return outcome, outcome
    with said_after(_compiling(params, experiment)), Beside(1) as beside:
        outcome = evaluate(params, experiment, trace=True)
        # Now compiled, but still running; what another thread asks of JAX runs on another core meanwhile.
        still = beside.submit(evaluate, params, without_motion(experiment), trace=True)
        # It draws the result, and takes a while to load.
        import_module("matplotlib.figure")
        return _on_host(outcome), _on_host(still.result())


def _on_host(outcome: "Outcome") -> "Outcome":
    """The same as numpy: JAX hands results over before they are there, and compiles even taking an element."""
    import jax
    import numpy as np

    found: Outcome = jax.tree.map(np.asarray, outcome)
    return found


def without_motion(experiment: "Experiment") -> "Experiment":
    """The same with the Heartbox off; it differs in data alone, so the program of the first run serves it."""
    from msgspec.structs import replace

    from jaxmpc.world.heart.motion import Motion

    return replace(experiment, motion=Motion(kind="none"))


def _with_physics(experiment: "Experiment", physics: str | None) -> "Experiment":
    """In another physics, under a name of its own so that neither run writes over the other."""
    from msgspec.structs import replace

    from jaxmpc.engine.scenario import with_physics

    if physics in (None, experiment.physics):
        return experiment
    return replace(with_physics(experiment, physics), name=f"{experiment.name}-{physics}")


def _compiling(params: "Params", experiment: "Experiment") -> str:
    return f"compiling and running {experiment.name}, {params.architecture} …"


def _damping(experiment: "Experiment") -> str:
    return experiment.damping if experiment.physics == "linear" else "sampled"


def _tables(label: str, outcome: "Outcome", compared: dict[str, "Outcome"], experiment: "Experiment") -> None:
    import numpy as np

    from jaxmpc.cli import comparison
    from jaxmpc.terminal.tables import RESIDUAL_HEADER, metric_header, metric_rows, residual_rows, show

    rows = residual_rows(label, outcome, experiment)
    for name, other in compared.items():
        rows += residual_rows(name, other, experiment)
    show("", RESIDUAL_HEADER, rows, keys=2)
    show("all that was measured, X / Y / Z", metric_header(experiment), metric_rows(outcome, experiment))
    if experiment.physics != "linear" and (rows := comparison.paper_rows(outcome, experiment)):
        show("beside the paper's Table I", comparison.PAPER_HEADER, rows, keys=2)
        if len(deviation := 100.0 * np.abs(comparison.deviations(outcome, experiment))):
            worst, median = np.max(deviation), np.median(deviation)
            print(f"RMS off Table I: worst cell {worst:.0f} %, median {median:.0f} %\n")
    if compared:
        rows = comparison.reduction_rows(outcome, compared, experiment)
        show(f"RMS of {label} lower by", comparison.REDUCTION_HEADER, rows, keys=2)


def _figures(
    folder: Path, experiment: "Experiment", controller: str, outcome: "Outcome", still: "Outcome"
) -> int | None:
    """Draw the worst of what ended well; its row, or None where nothing did."""
    from jaxmpc.pictures.experiment_figures import drawn_of, experiment_figure, row_to_draw, spectrum_figure
    from jaxmpc.terminal.tables import show

    row = row_to_draw(outcome, still)
    if row is None:
        print("figures: none, because no run held to its end at any stiffness")
        return None
    path = folder / f"{experiment.name}.png"
    experiment_figure(path, experiment, controller, outcome, still, row)
    print(f"figure: {path} ({experiment.stiffness[row]:g} N/m{drawn_of(outcome, still)})")
    scored = experiment.duration - experiment.settle
    if still is not outcome and scored < SHORTEST:
        print(f"no spectrum of the disturbance: {scored:g} s are scored, and {SHORTEST:g} s tell frequencies apart")
    elif still is not outcome:
        path = folder / f"{experiment.name}-spectrum.png"
        found = spectrum_figure(path, experiment, controller, outcome, still, row)
        amplitudes = [
            [f"{frequency:.2f}", *(f"{newton:.2f} / {mm:.2f}" for newton, mm in zip(force, motion, strict=True))]
            for frequency, force, motion in zip(found.frequency, found.force.T, found.motion.T, strict=True)
        ]
        if amplitudes:
            show(
                f"peaks of the disturbance, {experiment.stiffness[row]:g} N/m",
                ("f Hz", "X N / mm", "Y N / mm", "Z N / mm"),
                amplitudes,
            )
        print(f"figure: {path}")
    return row


def _statuses(label: str, outcome: "Outcome", experiment: "Experiment") -> None:
    """One line for every stiffness that did not end OK: what happened, and when."""
    import numpy as np

    from jaxmpc import Status
    from jaxmpc.quantities import AXES

    for stiffness, code, when in zip(experiment.stiffness, outcome.status, outcome.when, strict=True):
        status, at = Status(int(code)), float(when)
        if status != Status.OK:
            moment = f" at {at:.2f} s" if np.isfinite(at) else ""
            if status == Status.UNSTABLE and moment:
                moment = f", force out of bounds{moment}"
            print(f"{label}{stiffness:g} N/m: {status.name}{moment}: {status.sentence}")
    steps = [axis for axis in AXES if isinstance(value := getattr(experiment.reference, axis), float) and value]
    if steps and experiment.physics != "linear" and (np.asarray(outcome.status) != Status.OK).any():
        ramp = '{ kind = "ramp", to = -5.0, rate = 2.0 }'
        print(
            f"reference.{steps[-1]} is wanted at once, which no run on a robot does: begin with a ramp, "
            f"{steps[-1]} = [{ramp}]"
        )
