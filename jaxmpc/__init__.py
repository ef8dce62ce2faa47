"""A differentiable batch simulator for tuning a robot's force controller, and the road from there to the robot.

Importing this package loads no JAX: the names below are fetched when they are first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome
    from jaxmpc.evaluation import evaluate
    from jaxmpc.experiment import Experiment
    from jaxmpc.files.errors import InputError
    from jaxmpc.stability import Margins, margins
    from jaxmpc.status import Status
    from jaxmpc.synthesis import design
    from jaxmpc.synthesis.params import Params
    from jaxmpc.synthesis.timing import Timing
    from jaxmpc.terminal.process import remember_programs

__version__ = "0.1.0"

_HOME = {
    "Experiment": "jaxmpc.experiment",
    "InputError": "jaxmpc.files.errors",
    "Margins": "jaxmpc.stability",
    "Outcome": "jaxmpc.closed_loops",
    "Params": "jaxmpc.synthesis.params",
    "Status": "jaxmpc.status",
    "Timing": "jaxmpc.synthesis.timing",
    "design": "jaxmpc.synthesis",
    "evaluate": "jaxmpc.evaluation",
    "margins": "jaxmpc.stability",
    "remember_programs": "jaxmpc.terminal.process",
}

__all__ = [
    "Experiment",
    "InputError",
    "Margins",
    "Outcome",
    "Params",
    "Status",
    "Timing",
    "design",
    "evaluate",
    "margins",
    "remember_programs",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'jaxmpc' has no attribute {name!r}")
    from importlib import import_module

    try:
        return getattr(import_module(_HOME[name]), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("jaxmpc"):
            raise
        # As on a robot, which has numpy and python-can alone.
        text = f"jaxmpc.{name} needs {error.name}: install the workstation, pip install 'jaxmpc[sim]'"
        raise ModuleNotFoundError(text, name=error.name) from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
