"""`jaxmpc completion`: a script with which a shell completes verbs, options and files."""

import argparse

SHELLS = ("bash", "zsh", "tcsh")


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
            if not action.choices:
                setattr(action, "complete", shtab.FILE)  # noqa: B010 - shtab reads it, argparse does not know it
    print(shtab.complete(parser, args.shell))
    return 0
