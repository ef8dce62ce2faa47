"""Designed controllers in the worlds of a job: what is measured of them, in time or from spectra, and their margins."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.engine.registry import choose
from jaxmpc.law.cascade import Gains
from jaxmpc.loop.linear import AxisSignals
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import HP_MAX, METRICS
from jaxmpc.spectra.effort import chatter_rms, effort_rms
from jaxmpc.spectra.residual import residual_rms
from jaxmpc.spectra.spectrum import Spectrum
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis import design_one
from jaxmpc.synthesis.params import Params
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath
from tuning.job.risk import Risk
from tuning.job.space import FreeParameter

SPECTRAL = {"rms": residual_rms, "effort": effort_rms, "chatter": chatter_rms}
"""Metrics that a frequency response and a spectrum give."""
STEP_SAMPLES = 512
"""Length of the step response in which the overshoot is looked for [samples]."""


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
    """Factors on what the spectra say, (starts, stiffness, scenarios, 3); on the RMS for what they do not see. None
    corrects nothing."""
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
    """Stiffnesses at which they are [N/m]."""
    reference: Metrics
    """Metrics of the start point, (stiffness, scenarios, 3); for goals that are ratios."""


class Designed(NamedTuple):
    """One controller, the worlds that it runs in, and how it stands to its margins."""

    params: Params
    gains: Gains
    contacts: Contact
    """(stiffness,)"""
    found: Margins
    """(judged_at,)"""


def designed(params: Params, data: Data, width: Any) -> Designed:
    """Design one controller and judge its margins as `jaxmpc.margins` defines them; traceable."""
    scene = data.scene
    gains, residual = design_one(params, scene.path.T_s, width)
    return Designed(params, gains, *worlds_of(gains, params.K2, data, residual))


def worlds_of(gains: Gains, K2: Any, data: Data, residual: Any = 0.0) -> tuple[Contact, Margins]:
    """Where one controller runs (stiffness,), and its margins (judged_at,); traceable."""

    def judge(K_s: Any) -> Margins:
        return margins_one(gains, contact_of(K_s, K2, data.judged), data.judged.ideal, residual)

    met = jax.vmap(lambda K_s: contact_of(K_s, K2, data.scene.path))(data.scene.stiffness)
    return met, jax.vmap(judge)(data.judged_at)


def cells_of(controllers: Designed, data: Data, kind: ProblemStructure) -> Metrics:
    """What is measured of every controller, (starts, stiffness, scenarios, 3); traceable.

    From spectra it is residual RMS, effort and chatter; the peaks are NaN, or with a correction a multiple of the RMS.
    """
    scene, world = data.scene, kind.world
    if data.spectra is None:
        met = controllers.gains, controllers.params.K2, controllers.contacts
        found = choose(world).simulate(world, *met, scene, kind.precision)
        flat = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), found.metrics)
        cells: Metrics = jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:2], -1, 3), flat)
        return cells

    def spectral(gains: Gains, contact: Contact, spectrum: Spectrum) -> Metrics:
        known = {name: function(gains, contact, spectrum) for name, function in SPECTRAL.items()}
        return Metrics(**{name: known.get(name, jnp.full_like(known["rms"], jnp.nan)) for name in METRICS})

    over_scenarios = jax.vmap(spectral, in_axes=(None, None, 0))
    over_tissues = jax.vmap(over_scenarios, in_axes=(None, 0, None))
    seen: Metrics = jax.vmap(over_tissues, in_axes=(0, 0, None))(controllers.gains, controllers.contacts, data.spectra)
    if data.correction is None:
        return seen
    corrected: Metrics = jax.tree.map(jnp.multiply, following_rms(seen), data.correction)
    return corrected


def following_rms(spectral: Metrics) -> Metrics:
    """What spectra tell of a loop, the residual's RMS in place of every metric that they do not."""
    return spectral._replace(**{name: spectral.rms for name, metric in METRICS.items() if not metric.spectral})


def overshoot_of(controllers: Designed, data: Data, kind: ProblemStructure) -> Float[Array, "starts stiffness"]:
    """How far the force of the linear loop exceeds a step of its reference, relative to the step; traceable."""
    quiet, one = jnp.zeros((1, STEP_SAMPLES)), jnp.ones((1, STEP_SAMPLES))
    wanted = jnp.ones((1, STEP_SAMPLES, HP_MAX if kind.world.preview else 1))
    linear = kind.world._replace(engine="scan", robot=None)
    step = data.scene._replace(signals=AxisSignals(quiet, quiet, wanted, one), lsb=jnp.zeros(1))
    met = controllers.gains, controllers.params.K2, controllers.contacts
    found = choose(linear).simulate(linear, *met, step, "float64")
    return jnp.maximum(found.metrics.peak_force[..., 0] - 1.0, 0.0)


@partial(jax.jit, static_argnames=("kind",))
def measure(params: Params, data: Data, kind: ProblemStructure) -> Metrics:
    """What is measured of one controller, (stiffness, scenarios, 3)."""
    one = jax.tree.map(lambda leaf: leaf[None], designed(params, data, 1.0))
    cells: Metrics = jax.tree.map(lambda leaf: leaf[0], cells_of(one, data, kind))
    return cells
