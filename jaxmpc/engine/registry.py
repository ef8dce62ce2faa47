"""Every engine by its name, and the one for a program."""

from jaxmpc.engine.base import Engine, Mode, ProgramSpec
from jaxmpc.engine.mjx import Mjx
from jaxmpc.engine.scan import Scan
from jaxmpc.files.errors import InputError, nearest

ENGINES: dict[str, Engine] = {engine.name: engine for engine in (Scan(), Mjx())}


def choose(spec: ProgramSpec, mode: Mode | None = None) -> Engine:
    """The engine of a program.

    Args:
        spec: Structure of the program.
        mode: How it is going to be differentiated; None not at all.

    Raises:
        InputError: The engine is unknown or cannot do that.
    """
    if spec.engine not in ENGINES:
        raise InputError("engine", spec.engine, "a known one", nearest(spec.engine, list(ENGINES)))
    engine = ENGINES[spec.engine]
    if mode is not None and mode not in engine.modes:
        raise InputError("engine", spec.engine, f"able to differentiate in {mode} mode", "Take another physics.")
    return engine
