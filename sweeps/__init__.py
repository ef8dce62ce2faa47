"""Many controllers and worlds, evaluated, resumed, shared among machines, refined, explained.

    result = sweeps.run.run(SweepSpec.from_toml("spec.toml"), "runs/first")
    result = sweeps.load("runs/first")

Public names load when first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sweeps.result import Result
    from sweeps.spec import SweepSpec

__all__ = ["Result", "SweepSpec", "load"]

_PLACES = {"Result": "sweeps.result", "SweepSpec": "sweeps.spec"}


def load(folder: Any) -> "Result":
    """The rows that a sweep's folder holds so far; see `Result`.

    Raises:
        InputError: The folder is no sweep's.
    """
    found: Result = import_module("sweeps.result").Result.load(folder)
    return found


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
