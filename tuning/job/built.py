"""A tuning job that is built in Python, in the numbers that one of a file has."""

from collections.abc import Mapping
from typing import Any

import msgspec

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import check_type
from jaxmpc.files.toml import convert, plain_data, without_arrays
from jaxmpc.synthesis.params import Params
from tuning.job.risk import Risk
from tuning.job.scenarios import Scenarios
from tuning.job.settings import TuneSettings

TABLES: Mapping[str, type[msgspec.Struct]] = {"tune": TuneSettings, "scenarios": Scenarios, "risk": Risk}
GIVEN = {"experiment": Experiment, "params": Params, "baseline": Params | None}
NUMBERS = ("goals", "soft", "free", "pareto")
"""Fields of limits and bounds by name: 2 and 2.0 are one, and make one job."""


def made_plain(job: msgspec.Struct) -> None:
    """Hold a job's parts to their types and bounds, and put Python's numbers in the place of numpy's and JAX's.

    Args:
        job: A `TuneSpec`.

    Raises:
        InputError: A part is of another type, or a value of a table out of bounds.
    """
    for name, kind in GIVEN.items():
        check_type(name, getattr(job, name), kind, "`from_dict` takes names and tables.")
    found: dict[str, Any] = {}
    for name, table in TABLES.items():
        check_type(name, getattr(job, name), table, "`from_dict` takes tables.")
        found[name] = convert(plain_data(getattr(job, name)), table, name)
    found |= {name: _floats(without_arrays(getattr(job, name))) for name in NUMBERS}
    for name, value in found.items():
        msgspec.structs.force_setattr(job, name, value)


def _floats(data: Any) -> Any:
    """Plain data whose whole numbers are floats; all else as it is."""
    if isinstance(data, dict):
        return {key: _floats(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_floats(value) for value in data]
    return float(data) if type(data) is int else data
