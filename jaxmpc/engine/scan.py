"""The default engine: a scan over time, for the linear loop and the arm, on every device and in both modes."""

from math import inf
from typing import Any

from jaxmpc.engine.arm_scan import Transform, over_arm_cells
from jaxmpc.engine.base import CellResults, Engine, ProgramSpec, ScenarioData, as_dtype, scalars
from jaxmpc.engine.forward_dynamics import implicit
from jaxmpc.engine.linear_scan import over_cells, record, run
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmLoop
from jaxmpc.world.arm import chain
from jaxmpc.world.contact import Contact
from jaxmpc.world.joint_acceleration import Accelerate
from jaxmpc.xla.cse import sharing


class Scan(Engine):
    """Time as `jax.lax.scan`, each step's intermediate values shared."""

    name = "scan"
    text = "a scan over time"

    def simulate(
        self,
        spec: ProgramSpec,
        gains: Gains,
        K2: Any,
        contacts: Contact | None,
        data: ScenarioData,
        dtype: Any,
        traced: bool = False,
    ) -> CellResults:
        """See `Engine.simulate`."""
        gains = scalars(gains, spec.preview)
        if spec.robot is not None:
            return on_arm(spec, implicit, sharing, gains, K2, data, dtype, traced)
        cells = as_dtype((gains, contacts, data.lsb, data.signals, data.force_limit), dtype)
        metrics, diverged, over_limit = over_cells(run, *cells)
        never = diverged + inf
        samples = over_cells(record, *cells[:-1]) if traced else None
        return CellResults(metrics, diverged, over_limit, never, never, samples)


def on_arm(
    spec: ProgramSpec,
    accelerate: Accelerate,
    transform: Transform,
    gains: Gains,
    K2: Any,
    data: ScenarioData,
    dtype: Any,
    traced: bool,
) -> CellResults:
    """The arm as a scan; `simulate` with gains taken apart, whatever the engine's way to joint accelerations."""
    assert spec.robot is not None
    loop = ArmLoop(chain(), spec.robot, accelerate)
    numbers = gains, K2, data.robot, data.stiffness, data.signals, data.force_limit
    gains, K2, robot, stiffness, signals, limit = as_dtype(numbers, dtype)
    found = over_arm_cells(loop, gains, K2, robot, stiffness, signals, limit, traced, transform)
    metrics, trouble, samples = found
    return CellResults(metrics, *trouble, samples)
