"""The command line: a table of verbs, each a module that is imported when it is called."""

import argparse
import os
import select
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from jaxmpc.files.errors import InputError


class Verb(NamedTuple):
    """A verb of the command line."""

    module: str
    """Where its `configure(parser)` and `run(args)` are; imported when it is called."""
    text: str
    """What it is for, in one line."""


VERBS = {
    "demo": Verb("jaxmpc.cli.demo", "the whole story in one go: paper → sweep → tune → freeze → fly, with pictures"),
    "simulate": Verb("jaxmpc.cli.simulate", "one experiment: table, margins, figures"),
    "sweep": Verb(
        "sweeps.cli", "many controllers over a set of stiffnesses; run it again to resume; `sweep report` shows it"
    ),
    "tune": Verb("tuning.cli", "gradient autotuning, worst case over stiffness, margins held"),
    "compare": Verb("jaxmpc.cli.compare", "controllers side by side: one table with differences, one report"),
    "limit": Verb("jaxmpc.cli.limit", "the least residual that any linear law could reach, and a controller beside it"),
    "trials": Verb("tuning.trials.cli", "random trials of a controller on the arm: how often is it lost, or swings"),
    "freeze": Verb("jaxmpc.cli.freeze", "parameters → a sealed controller for the robot"),
    "identify": Verb(
        "jaxmpc.cli.identify", "joint friction and mass error of the arm from a recording of its own motion"
    ),
    "check": Verb("deploy.cli.check", "replay a frozen controller's golden trace, print its limits and margins"),
    "sign": Verb("deploy.cli.sign", "say with an Ed25519 key who froze a controller"),
    "doctor": Verb("deploy.cli.doctor", "is this machine, its bus and its clock fit to run a controller?"),
    "twin": Verb(
        "deploy.twin.cli",
        "a simulated WAM with pendant, force sensor and beating heart that speaks the arm's CAN protocol",
    ),
    "run": Verb("deploy.cli.run", "drive the arm with a frozen controller, over CAN or against the twin"),
    "replay": Verb(
        "jaxmpc.cli.replay", "a flight recording through the frozen controller once more: where do they part?"
    ),
}


_WORKSTATION = ("jax", "equinox", "optax", "msgspec", "mujoco", "tomli_w", "rich", "matplotlib", "scipy")
"""What is missing where only the robot's packages are."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; exit code 0: done, 1: the job failed, 2: wrong input, 130: interrupted, 141: nobody reads."""
    argv = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog="jaxmpc",
        description="Tune a cascade MPC-AOB force controller in simulation and take it to the robot.",
        epilog="`jaxmpc VERB --help` says more of each.",
    )
    parser.add_argument("--version", action="version", version=_version())
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    chosen = next((word for word in argv if not word.startswith("-")), None)
    for name, verb in VERBS.items():
        subparser = subparsers.add_parser(name, help=verb.text, description=verb.text[0].upper() + verb.text[1:] + ".")
        if name == chosen:
            module = import_module(verb.module)
            module.configure(subparser)
    args = parser.parse_args(argv)
    try:
        code = int(module.run(args))
        sys.stdout.flush()
        return code
    except InputError as error:
        print(f"jaxmpc {args.verb}: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if error.name not in _WORKSTATION:
            raise
        print(f"jaxmpc {args.verb}: it needs {error.name}: install the workstation, jaxmpc[sim]", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\njaxmpc {args.verb}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        if not _unread(sys.stdout.fileno()):
            raise
        # Who reads has had enough, as `head` has; what Python still wants to flush at its end goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _unread(descriptor: int) -> bool:
    """Whether it is a pipe whose other end is closed."""
    watch = select.poll()
    watch.register(descriptor, 0)
    return any(event & select.POLLERR for _, event in watch.poll(0))


def _version() -> str:
    from jaxmpc import __version__

    return f"jaxmpc {__version__}"
