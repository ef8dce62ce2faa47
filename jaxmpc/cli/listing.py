"""`jaxmpc list`: names that the other verbs know, with a line on each."""

import argparse
import re
import shutil
import textwrap
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import get_args, get_type_hints


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("what", nargs="*", metavar="KIND", help=f"{', '.join(KINDS)} (all)")
    parser.add_argument("--names", action="store_true", help="the bare names, for scripts")


def run(args: argparse.Namespace) -> int:
    """Print the names.

    Raises:
        InputError: There is no such kind.
    """
    from jaxmpc.files.errors import InputError, nearest

    for kind in args.what:
        if kind not in KINDS:
            raise InputError("KIND", kind, "a known one", nearest(kind, list(KINDS)))
    for number, kind in enumerate(args.what or KINDS):
        title, names = KINDS[kind]
        found = names()
        if args.names:
            print("\n".join(found))
            continue
        print("\n" * (number > 0) + title)
        indent, width = 4 + max(map(len, found)), shutil.get_terminal_size().columns
        for name, text in found.items():
            if width < 2 * indent:  # too narrow for two columns: the text goes below its name
                print(f"  {name}\n{textwrap.indent(textwrap.fill(text, max(width - 4, 16)), ' ' * 4)}")
            else:
                print(textwrap.fill(f"  {name}".ljust(indent) + text, width, subsequent_indent=" " * indent))
    return 0


def _experiments() -> dict[str, str]:
    return _heads(_folder("jaxmpc.experiment") / "published")


def _jobs() -> dict[str, str]:
    return _heads(_folder("jaxmpc") / "examples")


def _params() -> dict[str, str]:
    from jaxmpc.synthesis.published import PUBLISHED

    return dict(PUBLISHED)


def _rhythms() -> dict[str, str]:
    """What `jaxmpc twin --rhythm` takes; kinds of an experiment's motion are among them."""
    from deploy.twin.scenario import HEARTS, SCENARIOS
    from jaxmpc.world.heart.motion import Motion

    told = _experiments()
    names: tuple[str, ...] = get_args(get_type_hints(Motion)["rhythm"])
    rhythms = {name: told.get(f"rhythm-{name}", "") for name in names}
    hearts = dict(zip(HEARTS, ("The seven peaks of the paper's Fig. 4.", "The heart at rest."), strict=True))
    return hearts | rhythms | {name: told[name] for name in SCENARIOS}


def _recordings() -> dict[str, str]:
    from jaxmpc.cli.identify import SAMPLE

    return {SAMPLE: "The arm's own motion without contact, made by the twin."}


def _tissues() -> dict[str, str]:
    from jaxmpc.world.tissue import LAWS

    return {name: (law.__doc__ or "").splitlines()[0].replace("`", "") for name, law in LAWS.items()}


def _folder(package: str) -> Path:
    return Path(str(resources.files(package)))


def _heads(folder: Path) -> dict[str, str]:
    """Files of a folder by name, with the sentence in their first line of comment."""
    found = {}
    for path in sorted(folder.glob("*.toml")):
        comment = path.read_text(encoding="utf-8").partition("\n\n")[0].replace("\n# ", " ").removeprefix("# ")
        found[path.stem] = f"{re.split(r'(?<!Fig)[.] ', comment.splitlines()[0])[0].rstrip('.')}."
    return found


KINDS: dict[str, tuple[str, Callable[[], dict[str, str]]]] = {
    "experiments": ("experiments, for simulate, freeze --experiment, run and twin --experiment, trials", _experiments),
    "params": ("parameter sets, for simulate --params, freeze, trials, limit --params", _params),
    "jobs": ("jobs that come with the program: *-tune for tune, *-sweep to copy for sweep", _jobs),
    "rhythms": ("hearts, for twin --rhythm, run --rhythm", _rhythms),
    "recordings": ("recordings to try, for identify", _recordings),
    "tissues": ("laws of the tissue, for twin --tissue and [tissue] of an experiment", _tissues),
}
"""What is listed under which heading."""
