"""Every engine by its name, and the one for a program."""

import jax

from jaxmpc.engine.base import Engine, Mode, ProgramSpec
from jaxmpc.engine.kernel import Kernel
from jaxmpc.engine.mjx import Mjx
from jaxmpc.engine.scan import Scan
from jaxmpc.files.errors import InputError, nearest

ENGINES: dict[str, Engine] = {engine.name: engine for engine in (Scan(), Kernel(), Mjx())}


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


def fastest(spec: ProgramSpec) -> ProgramSpec:
    """The same program on the engine that runs many lanes fastest on this machine's devices.

    The kernel takes the place of the scan where there is a GPU: there a scan starts anew for each sample, and gives
    back to memory what the kernel keeps in registers.
    """
    on_gpu = jax.default_backend() in ENGINES["kernel"].devices
    return spec._replace(engine="kernel") if spec.engine == "scan" and on_gpu else spec
