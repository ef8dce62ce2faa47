"""What the words and flags of `jaxmpc sweep` ask for: a spec to run, or a verb that shows what a folder holds."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

from jaxmpc.files.errors import InputError, nearest
from sweeps.show.cli import VERBS

RUN_ONLY = {
    "dry_run": "--dry-run",
    "measure": "--measure",
    "chunk": "--chunk",
    "quiet": "--quiet",
    "cores": "--cores",
    "engine": "--engine",
    "part": "--part",
    "local_workers": "--local-workers",
    "cluster": "--cluster",
    "retry": "--retry",
    "silence": "--lease",
}
SHOW_ONLY = {"csv": "--csv", "max_ms": "--max-ms", "n": "-n", "goals": "--goals", "params": "--params"}


def verb_of(args: argparse.Namespace) -> str | None:
    """The verb that shows something; None where a sweep is to be run.

    Raises:
        InputError: There are too few words or too many, or a flag that belongs to the other kind.
    """
    verb = args.what[0] if args.what[0] in VERBS else None
    _check_words(verb, args.what)
    for name, flag in (SHOW_ONLY if verb is None else RUN_ONLY).items():
        if getattr(args, name) is not None:
            kind = "`jaxmpc sweep report` and its like" if verb is None else "running a sweep"
            raise InputError(flag, "given", "left out here", f"It belongs to {kind}.")
    return verb


def _check_words(verb: str | None, words: Sequence[str]) -> None:
    first, *rest = words
    said = " ".join(words)
    if verb is not None:
        wanted = "row DIR N" if verb == "row" else f"{verb} DIR"
        if len(words) != len(wanted.split()):
            by_number = "`jaxmpc sweep best DIR` lists some rows by their numbers N."
            raise InputError("arguments", said, wanted, by_number if verb == "row" else "Give one folder.")
    elif rest:
        known = f"SPEC.toml, or one of {', '.join(VERBS)} with DIR"
        remedy = f"Results go to -o {rest[0]}." if first.endswith(".toml") else nearest(first, list(VERBS))
        raise InputError("arguments", said, known, remedy)
    elif Path(first).is_dir():
        remedy = f"It is a folder: `jaxmpc sweep best {shlex.quote(first)}` shows the sweep in it."
        raise InputError("arguments", said, "SPEC.toml", remedy)
