"""Table I on the arm, and variants of it."""

from typing import Any

import msgspec

from jaxmpc import Experiment

replace = msgspec.structs.replace
TABLE = replace(Experiment.published("table-1"), physics="wam")
NO_COUNTS = {"lsb": (0.0, 0.0, 0.0)}


def changed(experiment: Experiment, **tables: Any) -> Experiment:
    """Keys of tables, or of the experiment itself, with other values."""
    new = {k: replace(getattr(experiment, k), **v) if isinstance(v, dict) else v for k, v in tables.items()}
    return replace(experiment, **new)
