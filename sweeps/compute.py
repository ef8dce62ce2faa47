"""Rows of a sweep, computed by a pure function of what can be pickled: any process on any machine may be asked."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np

from jaxmpc.closed_loops import Outcome, evaluate_block
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.blocks import BLOCK, over_blocks
from sweeps.plan import Columns, layout
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec


def compute(spec: SweepSpec, first: int, last: int) -> Columns:
    """Columns of the planned rows first … last − 1; no bit of a row depends on which others are asked for.

    Args:
        spec: The sweep; a recording that it names lies where it says.
        first: Place of the first row among the planned ones.
        last: Place behind the last.
    """
    rows = _planned(spec.space)[first:last]
    swept = spec.space.columns(rows)
    outcome = evaluated(spec, spec.params.with_columns(swept))
    measured = outcome.metrics._asdict() | outcome.margins._asdict()
    found = {"row": rows, **swept, "status": np.asarray(outcome.status)}
    for name in (*METRICS, *MARGINS):
        found[name] = np.array(measured[name])
        # One NaN, whatever sign and payload the processor made.
        found[name][np.isnan(found[name])] = np.nan
    columns = layout(spec.space, len(spec.experiment.stiffness), spec.precision)
    return {name: np.asarray(found[name], column.dtype) for name, column in columns.items()}


def evaluated(spec: SweepSpec, batch: Params) -> Outcome:
    """What controllers come to on the experiment of a sweep."""
    program = _program(program_spec(spec.experiment), spec.precision)
    with jax.enable_x64(True):
        outcome: Outcome = program(batch, _scenario(spec.experiment))
    return outcome


def rows_at_a_time() -> int:
    """Rows that are computed side by side: one block a device, so that one compilation serves them all."""
    return BLOCK * jax.local_device_count()


@lru_cache(maxsize=1)
def _planned(space: SweepSpace) -> np.ndarray:
    return space.rows()


@lru_cache(maxsize=1)
def _scenario(experiment: Experiment) -> ScenarioData:
    # The filter behind it would slow the linear loop down, which swings only where it is unstable.
    return scenario_data(experiment, swinging=experiment.physics != "linear")


@lru_cache(maxsize=8)
def _program(world: ProgramSpec, precision: str) -> Callable[[Any, Any], Any]:
    return over_blocks(partial(evaluate_block, world=world, dtype=precision))
