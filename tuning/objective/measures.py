"""What is measured of the closed loops of a job, in time or from spectra, and their margins."""

from collections.abc import Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.closed_loops import ClosedLoops, close_loops, margins_of, per_motion, run_loops
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.law.gains import Gains
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.schedule import repetition_of
from jaxmpc.loop.linear import AxisSignals
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import HP_MAX, METRICS
from jaxmpc.report.loops import STEP_SAMPLES
from jaxmpc.spectra.effort import chatter_rms, effort_rms
from jaxmpc.spectra.residual import residual_rms
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.spectra.true_force import swing_rms, true_rms
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.family import held
from jaxmpc.stability.held_beat import at_rates, telling_rates
from jaxmpc.stability.loop import contact_of, contacts_of, each_its_own
from jaxmpc.synthesis.params import Params
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla import store
from jaxmpc.xla.shared import JitShared
from tuning.job.risk import Risk
from tuning.job.space import FreeParameter

SPECTRAL = {
    "rms": residual_rms,
    "true_rms": true_rms,
    "effort": effort_rms,
    "chatter": chatter_rms,
    "swing": swing_rms,
}
"""Metrics that a frequency response and a spectrum give."""


class ProblemStructure(NamedTuple):
    """What needs a program of its own; all else is data."""

    axes: tuple[FreeParameter, ...]
    world: ProgramSpec
    precision: str
    risk: Risk


class Data(NamedTuple):
    """What a program takes besides the starts."""

    scene: ScenarioData
    spectra: Any
    """Spectra of the scenarios, stacked: then no time is stepped. Else None."""
    correction: Metrics | None
    """Factors on what the spectra say, (starts, stiffness, scenarios, 3); for what they do not see, on the metric that
    it follows. None corrects nothing."""
    base: Params
    """Values of what is frozen."""
    margins: Mapping[str, Any]
    """Hard goals on margins: limit per start, (starts,)."""
    hard: Mapping[str, Any]
    """Hard goals on the runs, (starts,)."""
    soft: Mapping[str, Any]
    """Soft goals, all on the runs."""
    judged: LoopPath
    """Loop whose margins are judged: of the experiment, as it runs or ideal."""
    judged_at: Any
    """Stiffnesses at which they are, (cells,) [N/m]."""
    believed: Any
    """K̂ that a family then holds, (cells,) [N/m]; NaN where it knows none. None for controllers without knots."""
    reference: Metrics
    """Metrics of the start point, (stiffness, scenarios, 3); for goals that are ratios."""


def judged_margins(loops: ClosedLoops, data: Data) -> Margins:
    """Margins of the loops that are judged, (starts, cells), as `jaxmpc.margins` defines them; traceable."""
    if data.believed is None:
        contacts = contacts_of(loops.K2, data.judged_at, data.judged.with_cutoff(loops.velocity_cutoff))
        return margins_of(loops._replace(contacts=contacts), ideal=data.judged.ideal)
    gains, contacts = known(loops, data.judged_at, data.believed, data.judged)
    residual = jnp.broadcast_to(loops.residual[:, None], contacts.stiffness.shape)

    def one(gains: Gains, contact: Contact, residual: Any, believed: Any, learning: Repetition | None) -> Margins:
        # Where the stiffness is not known nothing is learned. Freezing looks for the worst rate; here a few do.
        beats = None if learning is None else at_rates(learning, telling_rates(learning), jnp.isfinite(believed))
        return margins_one(gains, contact, data.judged.ideal, residual, beats)

    over_cells = jax.vmap(one, in_axes=(0, 0, 0, 0, None))
    over_starts = jax.vmap(over_cells, in_axes=(0, 0, 0, None, 0))
    found: Margins = over_starts(gains, contacts, residual, data.believed, repetition_of(loops.gains))
    return found


def known(loops: ClosedLoops, stiffness: Any, believed: Any, path: LoopPath) -> tuple[Gains, Contact]:
    """Families with K̂ held, and their contacts, (starts, cells).

    Args:
        loops: The families.
        stiffness: K_s, (cells,) [N/m].
        believed: K̂, likewise; NaN is not known.
        path: Delay and filters, where they bring none of their own.
    """
    gains, K2 = jax.vmap(held, in_axes=(0, 0, None))(loops.gains, loops.K2, believed)
    path = path.with_cutoff(loops.velocity_cutoff)
    over_cells = jax.vmap(contact_of, in_axes=(0, 0, None))
    return gains, jax.vmap(over_cells, in_axes=(None, 0, each_its_own(path)))(stiffness, K2, path)


def cells_of(loops: ClosedLoops, data: Data, structure: ProblemStructure) -> Metrics:
    """What is measured of every controller, (starts, stiffness, scenarios, 3); traceable.

    From spectra, to which a family knows each tissue, it is what `SPECTRAL` has; the rest is NaN, or with a
    correction a multiple of the RMS.
    """
    if data.spectra is None:
        run = run_loops(loops, data.scene, world=structure.world, dtype=structure.precision)
        cells: Metrics = jax.tree.map(lambda field: per_motion(field.astype(jnp.float64)), run.metrics)
        return cells

    def spectral(gains: Gains, contact: Contact, spectrum: Spectrum) -> Metrics:
        found = {name: function(gains, contact, spectrum) for name, function in SPECTRAL.items()}
        return Metrics(**{name: found.get(name, jnp.full_like(found["rms"], jnp.nan)) for name in METRICS})

    family, tissues = loops.gains.schedule is not None, data.scene.stiffness
    gains, contacts = known(loops, tissues, tissues, data.scene.path) if family else (loops.gains, loops.contacts)
    over_scenarios = jax.vmap(spectral, in_axes=(None, None, 0))
    over_tissues = jax.vmap(over_scenarios, in_axes=(0 if family else None, 0, None))
    seen: Metrics = jax.vmap(over_tissues, in_axes=(0, 0, None))(gains, contacts, data.spectra)
    if data.correction is None:
        return seen
    corrected: Metrics = jax.tree.map(jnp.multiply, with_stand_ins(seen), data.correction)
    return corrected


def with_stand_ins(spectral: Metrics) -> Metrics:
    """What spectra tell of a loop, and in place of every metric that they do not the one that it follows."""
    others = {name: getattr(spectral, row.follows) for name, row in METRICS.items() if not row.spectral}
    return spectral._replace(**others)


def overshoot_of(loops: ClosedLoops, data: Data, structure: ProblemStructure) -> Float[Array, "starts stiffness"]:
    """How far the force of the linear loop exceeds a step of its reference, relative to the step; traceable."""
    quiet, one = jnp.zeros((1, STEP_SAMPLES)), jnp.ones((1, STEP_SAMPLES))
    wanted: Any = jnp.ones((1, STEP_SAMPLES, HP_MAX if structure.world.preview else 1))
    linear = structure.world._replace(engine="scan", robot=None)
    step = data.scene._replace(signals=AxisSignals(quiet, quiet, wanted, one), lsb=jnp.zeros(1))
    run = run_loops(loops, step, world=linear, dtype="float64")
    return jnp.maximum(run.metrics.peak_force[..., 0] - 1.0, 0.0)


def measure(params: Params, data: Data, structure: ProblemStructure) -> Metrics:
    """What is measured of one controller, (stiffness, scenarios, 3)."""
    found: Metrics = _measuring(structure)(params, data)
    return found


@cache
def _measuring(structure: ProblemStructure) -> JitShared:
    return JitShared(partial(store.kept_or_plain, _measured, {"structure": structure}))


def _measured(params: Params, data: Data, structure: ProblemStructure) -> Metrics:
    one = jax.tree.map(lambda leaf: leaf[None], params)
    loops = close_loops(one, data.scene.stiffness, data.scene.path)
    cells: Metrics = jax.tree.map(lambda leaf: leaf[0], cells_of(loops, data, structure))
    return cells
