"""Arguments that several verbs share: a published name or a file."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxmpc.experiment import Experiment
    from jaxmpc.synthesis.params import Params


def params_from(text: str) -> "Params":
    """A published parameter set by name, or a params.toml by path."""
    from jaxmpc.synthesis.params import Params

    return Params.from_toml(text) if _is_path(text) else Params.published(text)


def experiment_from(text: str) -> "Experiment":
    """A published experiment by name, or a TOML file by path."""
    from jaxmpc.experiment import Experiment

    return Experiment.from_toml(text) if _is_path(text) else Experiment.published(text)


def _is_path(text: str) -> bool:
    return text.endswith(".toml") or "/" in text or Path(text).exists()
