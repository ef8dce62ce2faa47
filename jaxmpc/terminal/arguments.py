"""Arguments that several verbs share: a published name or a file."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    from jaxmpc.experiment import Experiment
    from jaxmpc.synthesis.params import Params

ENGINES = ("scan", "kernel", "mjx")
"""Names of `jaxmpc.engine.registry`, which takes a second to import."""


def engine_argument(parser: argparse._ActionsContainer) -> None:
    """Add --engine."""
    parser.add_argument("--engine", choices=ENGINES, help="what runs the loops (default: the fastest here, see doctor)")


def name_and_place(text: str) -> tuple[str, str]:
    """Name and place of what may be given as NAME=PLACE; no name where that, as a whole, is a place."""
    name, equals, place = text.partition("=")
    return (name, place) if equals and not Path(text).exists() else ("", text)


def params_from(text: str) -> "Params":
    """A published parameter set by name, whatever lies here under it; else a params.toml, or a tuning run's folder.

    Raises:
        InputError: It is none of these, or cannot be read.
    """
    from jaxmpc.synthesis.params import Params
    from jaxmpc.synthesis.published import SETS

    if text in SETS:
        return Params.published(text)
    if os.path.isdir(text):
        return Params.from_toml(tuned_file(Path(text)))
    if text.endswith(".npz"):
        remedy = "A frozen controller is flown (`jaxmpc run`), compared and checked; here its parameters are wanted."
        raise InputError("PARAMS", text, "a params.toml, a published set or the folder of a tuning run", remedy)
    return Params.from_toml(text) if _is_path(text) else Params.published(text)


def tuned_file(folder: Path) -> Path:
    """The params.toml in the folder of a tuning run.

    Raises:
        InputError: There is none.
    """
    file = folder / "params.toml"
    if not file.is_file():
        remedy = "It is written where every goal is met; its report says what was missed."
        raise InputError("tuning folder", folder, "one with a params.toml", remedy)
    return file


def experiment_from(text: str) -> "Experiment":
    """A published experiment by name, or a TOML file by path."""
    from jaxmpc.experiment import Experiment
    from jaxmpc.synthesis.published import SETS

    # A folder may have an experiment's name; what no name is like is read, and the error says that it is a folder.
    if text.endswith(".toml") or "/" in text or Path(text).is_file():
        return Experiment.from_toml(text)
    if text in SETS:
        remedy = f"{text} is a controller (for --params); name what it is to meet, table-1-wam say."
        raise InputError("EXPERIMENT", text, "an experiment", remedy)
    return Experiment.published(text)


def _is_path(text: str) -> bool:
    # The path of an empty text is the folder one is in.
    return text.endswith(".toml") or "/" in text or (text != "" and Path(text).exists())
