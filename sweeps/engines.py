"""Which engine runs a sweep's rows, and on what."""

from typing import NamedTuple

import jax

from jaxmpc.engine.base import ProgramSpec
from jaxmpc.engine.registry import fastest, named
from jaxmpc.engine.scenario import program_spec
from jaxmpc.files.errors import InputError
from sweeps.blocks import in_pairs
from sweeps.machine import processor
from sweeps.plan import Plan
from sweeps.spec import SweepSpec


class Devices(NamedTuple):
    """What computes."""

    number: int
    kind: str
    """Name of the processor, or of the GPU."""


def chosen(world: ProgramSpec, plan: Plan) -> ProgramSpec:
    """The program of a world, on the engine that was named or is fastest; pairs, whose worlds differ, have the scan.

    Raises:
        InputError: The engine that was named cannot run it here.
    """
    if plan.engine == "kernel" and in_pairs(plan):
        remedy = "Take --engine scan, or sweep the controller in few worlds."
        raise InputError("--engine", "kernel", "another one where every row has a world of its own", remedy)
    if plan.engine is not None:
        return named(world, plan.engine)
    return world if in_pairs(plan) else fastest(world)


def engine_of(plan: Plan) -> str:
    """Name of the engine that runs the base experiment's rows."""
    mjx = plan.canonical["experiment"]["physics"] == "mjx"
    return plan.engine or chosen(ProgramSpec("mjx" if mjx else "scan", False, None), plan).engine


def check(spec: SweepSpec, plan: Plan) -> None:
    """Refuse an engine that cannot run the sweep or a stage of it, before anything is computed.

    Raises:
        InputError: See `chosen`.
    """
    changes = [] if spec.refine is None else [stage.experiment for stage in spec.refine.stages]
    if spec.refine is not None and spec.refine.rerun is not None:
        changes.append(spec.refine.rerun.experiment)
    for experiment in (spec.experiment, *(spec.on(each).experiment for each in changes)):
        chosen(program_spec(experiment), plan)


def devices(cores: int) -> Devices:
    """What computes on this machine.

    Args:
        cores: How many cores of a CPU may be used.
    """
    if jax.default_backend() == "cpu":
        return Devices(cores, processor())
    return Devices(jax.local_device_count(), jax.local_devices()[0].device_kind)
