"""`jaxmpc completion`: a script with which a shell completes verbs, options, names that come with it and files."""

import argparse

from jaxmpc.cli.listing import KINDS

SHELLS = ("bash", "zsh", "tcsh")
NAMES = {
    "simulate": {"experiment": "experiments", "params": "params"},
    "tune": {"spec": "jobs"},
    "compare": {"what": "params", "experiment": "experiments"},
    "limit": {"experiment": "experiments", "params": "params"},
    "trials": {"params": "params", "against": "params", "experiment": "experiments"},
    "freeze": {"params": "params", "experiment": "experiments"},
    "identify": {"recording": "recordings"},
    "twin": {"experiment": "experiments", "rhythm": "rhythms"},
    "run": {"experiment": "experiments", "rhythm": "rhythms"},
}
"""Which arguments of a verb take a name of a kind in the place of a file."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("shell", choices=SHELLS, help='of: eval "$(jaxmpc completion bash)"')


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from jaxmpc.cli import VERBS, whole_parser

    parser = whole_parser()
    for verb in VERBS:
        for action in parser.of_verb(verb).taking_values():
            if action.choices or action.type in (int, float):
                continue
            kind = NAMES.get(verb, {}).get(action.dest)
            setattr(action, "complete", _names_or_files(kind) if kind else shtab.FILE)  # noqa: B010 - for shtab alone
    for verb, dest, words in (("list", "what", tuple(KINDS)), ("twin", "tissue", _names("tissues"))):
        (action,) = (each for each in parser.of_verb(verb).taking_values() if each.dest == dest)
        action.choices = words
        delattr(action, "complete")
    functions = {shell: "\n".join(_function(kind, shell) for kind in KINDS) for shell in ("bash", "zsh")}
    script = shtab.complete(parser, args.shell, preamble=functions.get(args.shell, ""))
    # Of what may come again, as in `compare A B` or `sweep report DIR`, shtab has zsh complete the first alone.
    print(script.replace('"(*)::', '"*:').replace('"(*):', '"*:') if args.shell == "zsh" else script)
    return 0


def _names(kind: str) -> tuple[str, ...]:
    """The names of a kind; of jobs those that `tune` takes."""
    return tuple(name for name in KINDS[kind][1]() if kind != "jobs" or name.endswith("-tune"))


def _names_or_files(kind: str) -> dict[str, str]:
    """What shtab calls in each shell; a pattern of tcsh has names or files, not both."""
    return {"bash": f"_jaxmpc_{kind}_or_files", "zsh": f"_jaxmpc_{kind}_or_files", "tcsh": "f"}


def _function(kind: str, shell: str) -> str:
    words = " ".join(_names(kind))
    offered = {
        "bash": f'compgen -W \'{words}\' -- "$1"; compgen -f -- "$1"',
        "zsh": f"_alternative 'names:{kind}:({words})' 'files:file:_files'",
    }[shell]
    return f"_jaxmpc_{kind}_or_files() {{ {offered}; }}"
