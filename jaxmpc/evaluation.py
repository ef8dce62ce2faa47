"""Evaluate controllers on an experiment: residuals and margins together, at each stiffness.

The public function is `jaxmpc.evaluate`; the module has another name so that importing it does not hide it.
"""

from typing import Literal, get_args

import jax
import jax.numpy as jnp

from jaxmpc.beside import Beside
from jaxmpc.closed_loops import ClosedLoops, Outcome, margins_of, outcome_of, run_loops
from jaxmpc.engine.base import CellResults
from jaxmpc.engine.scenario import program_spec, scenario_data, with_physics
from jaxmpc.experiment import Experiment, Physics
from jaxmpc.files.errors import InputError, check_type, nearest, truth
from jaxmpc.stability import Margins
from jaxmpc.stability.loop import contacts_between
from jaxmpc.synthesis import designed
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.values import MAKE_PARAMS, check_filled
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.rows import reshaped, traced

Precision = Literal["float64", "float32"]


def shaped_outcome(margins: Margins, run: CellResults, batch: tuple[int, ...]) -> Outcome:
    """The outcome with the batch's shape instead of one leading dimension."""
    found = outcome_of(margins, run)
    outcome: Outcome = jax.tree.map(lambda leaf: jnp.reshape(leaf, (*batch, *leaf.shape[1:])), found)
    return outcome


_outcome = JitOnce(shaped_outcome, static_argnames=("batch",))
_run = JitOnce(run_loops, static_argnames=("world", "dtype", "traced"))


@in_float64
def evaluate(
    params: Params,
    experiment: Experiment,
    *,
    physics: Physics | None = None,
    precision: Precision = "float64",
    trace: bool = False,
) -> Outcome:
    """Run controllers through an experiment.

    Never raises for a bad controller: its `status` says what happened. Metrics are NaN where the loop is unstable or
    ill-posed or the run diverged; one that left a limit of force or lost contact keeps them. For many
    thousands of controllers use `sweeps.run`, which works in blocks on all cores.

    Args:
        params: One controller or a batch.
        experiment: What they meet.
        physics: "linear", the contact loop; "wam", the arm; "mjx", the arm on stock MJX. None is the experiment's own.
        precision: Of the time stepping; design and margins are always float64.
        trace: Keep every sample of every signal.

    Returns:
        Metrics and margins per stiffness (and axis); see `Outcome`.

    Raises:
        InputError: The physics or precision is unknown, an argument of another type, or the batch empty.
    """
    check_type("params", params, Params, MAKE_PARAMS)
    remedy = 'Make one with Experiment.published("table-1"), Experiment.from_toml(FILE) or Experiment(…).'
    check_type("experiment", experiment, Experiment, remedy)
    trace = truth("trace", trace, "True keeps every sample.")
    experiment = with_physics(experiment, physics)
    for key, value, kind in (("physics", experiment.physics, Physics), ("precision", precision, Precision)):
        if value not in get_args(kind):
            raise InputError(key, value, "a known one", nearest(str(value), list(get_args(kind))))
    check_filled(batch := params.batch_shape)
    flat = reshaped(params, len(batch), -1)
    scene, world = scenario_data(experiment, swinging=True), program_spec(experiment)
    gains, residual = designed(flat, scene.path.T_s, scene.path.force_filter)
    cutoff = flat.velocity_cutoff
    contacts = contacts_between(flat.K2, scene.stiffness, scene.path.with_cutoff(cutoff))
    loops = ClosedLoops(gains, flat.K2, contacts, residual, cutoff)

    def judge() -> Margins:
        # A thread has a precision of its own.
        with jax.enable_x64(True):
            return margins_of(loops, ideal=scene.path.ideal)

    if traced(loops):
        margins, run = judge(), _run(loops, scene, world=world, dtype=precision, traced=trace)
    else:
        # Compiling is most of a first call, and the two programs compile side by side.
        with Beside(1) as beside:
            pending = beside.submit(judge)
            run = _run(loops, scene, world=world, dtype=precision, traced=trace)
            margins = pending.result()
    outcome: Outcome = _outcome(margins, run, batch=batch)
    return outcome
