"""The command line: a table of verbs, each a module that is imported when it is called."""

import argparse
import errno
import os
import select
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import NamedTuple

from jaxmpc.files.errors import InputError, nearest, plain
from jaxmpc.terminal.folding import folded_output
from jaxmpc.terminal.interruption import always_heard
from jaxmpc.terminal.parser import CommandParser
from jaxmpc.terminal.process import one_thread_for_blas, silence_libraries


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
    "doctor": Verb("jaxmpc.cli.doctor", "are this machine, its bus and its clock fit to run a controller? its engines"),
    "twin": Verb(
        "deploy.twin.cli",
        "a simulated WAM with pendant, force sensor and beating heart that speaks the arm's CAN protocol",
    ),
    "run": Verb("deploy.cli.run", "drive the arm with a frozen controller, over CAN or against the twin"),
    "replay": Verb(
        "jaxmpc.cli.replay", "a flight recording through the frozen controller once more: where do they part?"
    ),
    "list": Verb(
        "jaxmpc.cli.listing", "names that the other verbs know: experiments, parameters, jobs, rhythms, tissues"
    ),
    "completion": Verb("jaxmpc.cli.completion", "a script with which bash, zsh or tcsh completes verbs and options"),
}


_WORKSTATION = (
    *("jax", "jaxtyping", "equinox", "optax", "msgspec", "mujoco", "tomli_w", "rich", "matplotlib", "scipy", "shtab"),
)
"""What is missing where only the robot's packages are."""
_WRONG_INPUT = (
    *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP),
    *(errno.EROFS, errno.EEXIST, errno.ENXIO),
)
"""Errors of the system that another path would not have; a full disk is none."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; exit code 0: done, 1: the job failed, 2: wrong input, 130: interrupted, 141: nobody reads."""
    # Of a process that was started without them, as by some schedulers.
    sys.stdout = sys.stdout or open(os.devnull, "w")
    sys.stderr = sys.stderr or open(os.devnull, "w")
    for stream in (sys.stdin, sys.stdout, sys.stderr):
        # A terminal that cannot show ≤ shows ?, and a key that is no letter is one all the same; no reason to stop.
        if reconfigure := getattr(stream, "reconfigure", None):
            reconfigure(errors="replace")
    silence_libraries()
    one_thread_for_blas()
    with folded_output(), always_heard() as struck:
        return _main(argv, struck)


def _main(argv: Sequence[str] | None, struck: Callable[[], bool]) -> int:
    argv = list(sys.argv[1:] if argv is None else argv)
    chosen = next((word for word in argv if not word.startswith("-")), None)
    try:
        return _run(chosen, argv)
    except InputError as error:
        return _told(chosen, f"{error}", 2)
    except ImportError as error:
        if struck():
            return _told(chosen, "interrupted", 130)
        if not isinstance(error, ModuleNotFoundError) or error.name not in _WORKSTATION:
            raise
        return _told(chosen, f"it needs {error.name}: install the workstation, jaxmpc[sim]", 2)
    except KeyboardInterrupt:
        return _told(chosen, "interrupted", 130)
    except BrokenPipeError:
        if not _unread(sys.stdout.fileno()):
            raise
        # Who reads has had enough, as `head` has.
        _write_nowhere()
        return 141
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _told(chosen, f"{where}{error.strerror or error}", 2 if error.errno in _WRONG_INPUT else 1)
    except MemoryError:
        return _told(chosen, "there is not enough memory for it", 1)


def _run(verb: str | None, argv: Sequence[str]) -> int:
    args = _parsed(verb, argv)
    code = 0 if args is None else int(import_module(VERBS[args.verb].module).run(args))
    sys.stdout.flush()
    return code


def _parsed(verb: str | None, argv: Sequence[str]) -> argparse.Namespace | None:
    """What a verb was given; None without a verb, which the help answers."""
    if verb in VERBS:
        return _parser([verb]).parse_args(argv)
    parser = _parser([])
    if verb is not None:
        parser.error(f"{plain(verb, 80)}: must be a verb. {nearest(verb, list(VERBS))}")
    parser.check_options(argv)
    parser.parse_args(argv)
    parser.print_help()
    return None


def whole_parser() -> CommandParser:
    """The parser with the arguments of every verb, which imports them all."""
    return _parser(list(VERBS))


def _parser(configured: Sequence[str | None]) -> CommandParser:
    """A parser of all verbs, with the arguments of some."""
    parser = CommandParser(
        prog="jaxmpc",
        description="Tune a cascade MPC-AOB force controller in simulation and take it to the robot.",
        epilog="`jaxmpc VERB --help` says more of each; `jaxmpc demo` shows what it is about.",
    )
    parser.add_argument("--version", action="version", version=_version())
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB")
    for name, verb in VERBS.items():
        sentence = verb.text[0].upper() + verb.text[1:] + ("" if verb.text.endswith("?") else ".")
        subparser = subparsers.add_parser(name, help=verb.text, description=sentence)
        if name in configured:
            import_module(verb.module).configure(subparser)
    return parser


def _told(verb: str | None, text: str, code: int) -> int:
    try:
        sys.stdout.flush()
    except OSError:  # the disk is full, say: what is told then is told of that
        _write_nowhere()
    print(f"{' '.join(filter(None, ('jaxmpc', verb)))}: {plain(text)}", file=sys.stderr)
    return code


def _write_nowhere() -> None:
    """What Python still wants to flush at its end would fail once more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _unread(descriptor: int) -> bool:
    """Whether it is a pipe whose other end is closed."""
    watch = select.poll()
    watch.register(descriptor, 0)
    return any(event & select.POLLERR for _, event in watch.poll(0))


def _version() -> str:
    from jaxmpc import __version__

    return f"jaxmpc {__version__}"
