"""A short linear Table I of one's own, as a file."""

from pathlib import Path
from typing import Any

from jaxmpc import Experiment
from jaxmpc.files.toml import write_toml


def experiment_file(folder: Path, **changes: Any) -> str:
    """A short linear Table I of one's own."""
    plain = Experiment.published("table-1").to_dict() | {"name": "short", "duration": 8.0} | changes
    write_toml(folder / "short.toml", plain)
    return str(folder / "short.toml")
