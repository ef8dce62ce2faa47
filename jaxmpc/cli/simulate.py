"""`jaxmpc simulate`: one experiment, its table and its figure."""

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("experiment", help="a TOML file, or a published one: table-1, figure-3")
    parser.add_argument("--params", default="text", help="a params.toml, or a published set: text, printed (text)")
    parser.add_argument("-o", "--output", type=Path, help="folder for the figures (runs/NAME)")


def run(args: argparse.Namespace) -> int:
    """Simulate, print, draw; 1 when a stiffness did not end OK."""
    import msgspec

    from jaxmpc.cli.arguments import experiment_from, params_from
    from jaxmpc.cli.setup import use_all_cores
    from jaxmpc.cli.tables import RESIDUAL_HEADER, residual_rows, show

    use_all_cores()
    from jaxmpc import Status, evaluate
    from jaxmpc.cli.pictures import experiment_figure

    params, experiment = params_from(args.params), experiment_from(args.experiment)
    folder = args.output or Path("runs") / experiment.name
    print(
        f"experiment {experiment.name}: {experiment.duration:g} s, damping {experiment.damping}, params {args.params}"
    )
    outcome = evaluate(params, experiment, trace=True)
    show("", RESIDUAL_HEADER, residual_rows(params.architecture, outcome, experiment))
    still = msgspec.structs.replace(experiment, motion=msgspec.structs.replace(experiment.motion, kind="none", file=""))
    path = folder / f"{experiment.name}.png"
    experiment_figure(path, experiment, outcome, evaluate(params, still, trace=True))
    print(f"figure: {path}")
    for stiffness, code in zip(experiment.stiffness, outcome.status, strict=True):
        if code != Status.OK:
            print(f"{stiffness:g} N/m: {Status(int(code)).name}: {Status(int(code)).sentence}")
    return int(any(code != Status.OK for code in outcome.status))
