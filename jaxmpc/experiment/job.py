"""The tables that every job's file has: [experiment] and [params], each a published one or a file, then changes."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxmpc.experiment.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.synthesis.params import Params


def experiment_table(table: Mapping[str, Any], folder: Path) -> Experiment:
    """The experiment of a job.

    Args:
        table: `published` or `file` (relative to `folder`), and any keys of an experiment to change.
        folder: Where the job's file lies.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    published, file, changes = _source(table, "experiment")
    base = Experiment.from_toml(folder / file) if file else Experiment.published(published or "table-1")
    data = base.to_dict()
    if data["motion"]["file"]:
        # So that a path relative to the experiment's folder is not taken for one relative to the job's.
        data["motion"]["file"] = str(Path(data["motion"]["file"]).absolute())
    for key, value in changes.items():
        merge = isinstance(value, dict) and isinstance(data.get(key), dict)
        data[key] = {**data[key], **value} if merge else value
    return Experiment.from_dict(data, folder, "experiment")


def params_table(table: Mapping[str, Any], folder: Path, root: str = "params") -> Params:
    """A controller of a job.

    Args:
        table: `published` or `file` (relative to `folder`), and any parameters to change.
        folder: Where the job's file lies.
        root: The table's name.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    published, file, changes = _source(table, root)
    base = Params.from_toml(folder / file) if file else Params.published(published or "text")
    try:
        return Params.from_dict({**base.to_dict(), **changes})
    except InputError as error:
        raise replace(error, key=f"{root}.{error.key}") from None


def _source(table: Mapping[str, Any], root: str) -> tuple[str | None, str | None, dict[str, Any]]:
    """The published name or the file that a table starts from, and what it changes."""
    rest = {key: value for key, value in table.items() if key not in ("published", "file")}
    published, file = table.get("published"), table.get("file")
    for key, value in (("published", published), ("file", file)):
        if value is not None and not isinstance(value, str):
            raise InputError(f"{root}.{key}", value, "text", "Put it in quotes.")
    if published is not None and file is not None:
        raise InputError(f"{root}.file", file, f"given without {root}.published", "Remove one of the two.")
    return published, file, rest
