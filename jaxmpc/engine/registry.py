"""Every engine by its name, the one for a program, and whether one that somebody names can take its place."""

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


def named(spec: ProgramSpec, name: str | None, mode: Mode | None = None, *, traced: bool = False) -> ProgramSpec:
    """The same program on the engine that somebody names, if it can run it here.

    Args:
        spec: Structure of the program.
        name: Of the engine; None leaves the program as it is.
        mode: How it is going to be differentiated; None not at all.
        traced: Whether samples are wanted.

    Raises:
        InputError: It is unknown, or this is another physics, another machine, or nothing that it can do.
    """
    if name is None:
        return spec
    if name not in ENGINES:
        raise InputError("--engine", name, "a known one", nearest(name, list(ENGINES)))
    engine, physics = ENGINES[name], _physics(spec)
    others = [other.name for other in ENGINES.values() if physics in other.physics and not other.unfit()]
    remedy = f'Here {" or ".join(others) or "no engine"} runs physics = "{physics}"; left out, the choice is ours.'
    if physics not in engine.physics:
        raise InputError("--engine", name, f'one for physics = "{physics}"', remedy)
    if why := engine.unfit():
        raise InputError("--engine", name, f"one that runs on this machine ({name} {why})", remedy)
    if mode is not None and mode not in engine.modes:
        raise InputError("--engine", name, f"able to differentiate in {mode} mode", "Take --engine scan.")
    if traced and not engine.traces:
        raise InputError("--engine", name, "one that keeps samples", "Take --engine scan.")
    return spec._replace(engine=name)


def _physics(spec: ProgramSpec) -> str:
    if spec.robot is None:
        return "linear"
    return "mjx" if spec.engine == "mjx" else "wam"


def fastest(spec: ProgramSpec) -> ProgramSpec:
    """The same program on the engine that runs many lanes fastest on this machine's devices.

    The kernel takes the place of the scan where there is a GPU: there a scan starts anew for each sample, and gives
    back to memory what the kernel keeps in registers.
    """
    on_gpu = jax.default_backend() in ENGINES["kernel"].devices
    return spec._replace(engine="kernel") if spec.engine == "scan" and on_gpu else spec
