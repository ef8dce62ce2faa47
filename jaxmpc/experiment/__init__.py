"""Experiments: the tables of their TOML files, what is built from them, and the published ones.

Public names load when first asked for: the twin takes tables from here, on machines without jax.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from jaxmpc.quantities import AXES

if TYPE_CHECKING:
    from jaxmpc.experiment.experiment import Experiment, Physics
    from jaxmpc.experiment.signals import Signals
    from jaxmpc.experiment.tables import SensorSettings

__all__ = ["AXES", "Experiment", "Physics", "SensorSettings", "Signals"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("jaxmpc.experiment.experiment"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
