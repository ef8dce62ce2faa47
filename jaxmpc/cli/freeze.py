"""`jaxmpc freeze`: parameters → a sealed controller for the robot."""

import argparse
import math
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import FLOOR_FLAGS, HIGHEST_M_S, MARGINS, check_limit
from jaxmpc.terminal.progress import said_after

if TYPE_CHECKING:
    from jaxmpc.experiment import Experiment
    from jaxmpc.synthesis.params import Params

EXPERIMENT = "table-1"


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "params",
        help="a params.toml, a published set (text, printed, cautious, family, …), or the folder of a tuning run or, "
        "with --row, of a sweep",
    )
    parser.add_argument("--row", type=int, metavar="N", help="which row of a sweep; `jaxmpc sweep best DIR` lists some")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("controller.npz"), help="the file to make (controller.npz)"
    )
    parser.add_argument(
        "--experiment",
        help="its stiffnesses are the promise (table-1, which only replays; of a row the one that it met; to drive an "
        "arm: table-1-wam)",
    )
    parser.add_argument(
        "--limits", type=Path, metavar="TOML", help="limits on the arm that differ from the default (docs/robot.md)"
    )
    parser.add_argument("--ideal", action="store_true", help="declare the margins of the ideal loop, not as it runs")
    floor = parser.add_argument_group("margin floor, held at every stiffness from softest to hardest")
    for name, flag in FLOOR_FLAGS.items():
        margin, default = MARGINS[name], HIGHEST_M_S if name == "M_s" else None
        said = f"{'highest' if margin.ceiling else 'lowest'} {margin.heading}: {margin.text}"
        said += "" if default is None else f" ({default})"
        floor.add_argument(flag, dest=name, type=float, default=default, metavar="BOUND", help=said)


def run(args: argparse.Namespace) -> int:
    """Design, judge, freeze; an unstable controller or one below its floor is refused with exit code 2."""
    from jaxmpc.export.freezing import freeze_controller
    from jaxmpc.files.outputs import check_file
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    check_file("-o", args.output, ".npz")  # by which `compare` and `trials` tell it from parameters
    given = {name: getattr(args, name) for name in FLOOR_FLAGS}
    for name, value in given.items():
        if value is not None:
            remedy = "Leave it out to promise nothing of it."
            if not 0.0 < value < math.inf:
                raise InputError(FLOOR_FLAGS[name], value, "positive and finite", remedy)
            check_limit(FLOOR_FLAGS[name], MARGINS[name], value / MARGINS[name].times, remedy)
    floor = {name: value / MARGINS[name].times for name, value in given.items() if value is not None}
    params, experiment = _chosen(args)
    what = args.params if args.row is None else f"row {args.row} of {args.params}"
    with said_after(f"designing {what}, judging it on {experiment.name}, recording its golden trace …"):
        artifact = freeze_controller(args.output, params, experiment, floor, ideal=args.ideal, limits=args.limits)
    loop = "ideal loop" if args.ideal else "loop as it runs"
    # Of a family: of the fixed gains, and of those that fly where the stiffness is known.
    worst = max(row["M_s"] for row in (*artifact.margins, *(artifact.family or {"rows": ()})["rows"]))
    print(f"frozen: {args.output} ({args.output.stat().st_size} bytes), K_s {len(artifact.margins)} values, {loop}")
    kept = ", ".join(
        f"{MARGINS[name].heading} {MARGINS[name].sign} {MARGINS[name].entry(value)}"
        for name, value in artifact.floor.items()
    )
    print(f"worst M_s {worst:.3f}, margin floor {kept}")
    if artifact.arm is not None:
        limit = artifact.arm.limits.force
        print(f"drives a {artifact.arm.robot}; a force above {limit:g} N ends the run (docs/robot.md)")
    print(f"`jaxmpc check {shlex.quote(str(args.output))}` replays it anywhere")
    return 0


def _chosen(args: argparse.Namespace) -> "tuple[Params, Experiment]":
    """Controller and experiment that were asked for.

    Raises:
        InputError: One of them is none, or --row does not go with what was given.
    """
    from jaxmpc.terminal.arguments import experiment_from, params_from

    folder = Path(args.params)
    swept = os.path.exists(folder / "manifest.json") or os.path.isdir(folder / "stages")
    if args.row is not None and not swept:
        raise InputError("--row", args.row, "given with the folder of a sweep", f"{folder} is none: leave --row out.")
    if args.row is None:
        if swept:
            remedy = f"Add --row N; `jaxmpc sweep best {shlex.quote(str(folder))}` lists the best."
            raise InputError("--row", "missing", "the row of the sweep to freeze", remedy)
        return params_from(args.params), experiment_from(args.experiment or EXPERIMENT)
    from sweeps.result import Result
    from sweeps.show.best_rows import progress

    result = Result.load(folder)
    place = result.place(args.row)
    met = experiment_from(args.experiment) if args.experiment else result.experiment(place)
    if not result.complete:
        print(f"jaxmpc freeze: unfinished sweep: {progress(result)}", file=sys.stderr)
    return result.controller(place), met
