"""What is minimised: the soft goals over tissues and scenarios, the hard ones held, and its gradient."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.engine.cells import over_cells
from jaxmpc.engine.rollout import AxisSignals, run, scalars
from jaxmpc.law.cascade import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.params import HP_MAX, Params
from jaxmpc.scene import Scene, World, run_cells
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.chatter import chatter_rms, effort_rms
from jaxmpc.stability.loop import SENSOR_CUTOFF_HZ, VELOCITY_CUTOFF, contact_of
from jaxmpc.stability.residual import residual_rms
from jaxmpc.stability.spectrum import Spectrum
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import Contact, hertz
from tuning.goals import OVERSHOOT, PEAK, Standing, measured, standing
from tuning.risk import Risk, soft_worst
from tuning.transforms import Axis, Space

PENALTY = 10.0
"""Price of a violation in units of log residual: above its Lagrange multiplier (some 2) the penalty is exact."""
HEADROOM = 0.002
"""How far inside their limits the goals are aimed at, so that the last steps do not hover outside [-]."""
PEAK_TO_RMS = 6.0
"""Peak-to-peak of a residual over its RMS, 5.7 to 6.6 on Table I's arm [-]: weighs a peak's stand-in."""
STEP_SAMPLES = 512
"""Length of the step response in which the overshoot is looked for [samples]."""


class Values(NamedTuple):
    """What one look at all starts gives, each (starts, …)."""

    loss: Any
    gradient: Any
    score: Any
    """Risk of the soft goals [-]; NaN where unstable."""
    worst: Any
    """Largest residual RMS over stiffness, axis and scenario; NaN where unstable [N]."""
    tissue: Any
    """Where the soft goals stand worst, index into the stiffnesses."""
    M_s: Any
    """Peak sensitivity per stiffness at which margins are judged [-]."""
    hard: Any
    """Hard goals at their worst, (starts, goals), margins first; met at 1 and below [-]."""
    soft: Any
    """Soft goals at their worst, (starts, goals) [-]."""
    cells: Metrics
    """(starts, stiffness, scenarios, 3)"""


class Kind(NamedTuple):
    """What needs a program of its own; all else is data."""

    axes: tuple[Axis, ...]
    ideal_goals: bool
    world: World
    precision: str
    risk: Risk


class Data(NamedTuple):
    """What a program takes besides the starts."""

    scene: Scene
    spectra: Any
    """Of the scenarios, stacked: then no time is stepped. Else None."""
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
    judged_at: Any
    """Stiffnesses at which margins are judged [N/m]."""
    reference: Metrics
    """Of the start point, (stiffness, scenarios, 3); for goals that are ratios."""


def judged_contact(K_s: Any, K2: Any, scene: Scene, ideal: bool) -> Contact:
    """The world in which `jaxmpc.margins` judges: it runs through the WAM's filters or, if ideal, through none."""
    sensor = 0.0 if ideal else hertz(SENSOR_CUTOFF_HZ)
    return contact_of(K_s, K2, scene.T_s, scene.delay, ideal, VELOCITY_CUTOFF, sensor)


class Designed(NamedTuple):
    """One controller, the worlds that it runs in, and how it stands to its margins."""

    params: Params
    gains: Gains
    contacts: Contact
    """(stiffness,)"""
    found: Margins
    """(judged_at,)"""


def designed(params: Params, data: Data, width: Any, kind: Kind) -> Designed:
    """Design one controller and judge its margins as `jaxmpc.margins` defines them; traceable."""
    scene = data.scene
    gains, residual = design_one(params, scene.T_s, width)

    def contact(K_s: Any) -> Contact:
        filters = scene.delay, kind.world.ideal, scene.velocity_cutoff, scene.sensor_cutoff
        return contact_of(K_s, params.K2, scene.T_s, *filters)

    def judge(K_s: Any) -> Margins:
        judged = judged_contact(K_s, params.K2, scene, kind.ideal_goals)
        return margins_one(gains, judged, kind.ideal_goals, residual)

    return Designed(params, gains, jax.vmap(contact)(scene.stiffness), jax.vmap(judge)(data.judged_at))


def cells_of(controllers: Designed, data: Data, kind: Kind) -> Metrics:
    """What is measured of every controller, (starts, stiffness, scenarios, 3); traceable.

    From spectra it is residual RMS, effort and chatter; the peaks are NaN, or with a correction a multiple of the RMS.
    """
    scene, world = data.scene, kind.world
    if data.spectra is None:
        gains = jax.vmap(lambda g: scalars(g, world.preview))(controllers.gains)
        ran = run_cells(world, gains, controllers.params.K2, controllers.contacts, scene, kind.precision)
        flat = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), ran.metrics)
        cells: Metrics = jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:2], -1, 3), flat)
        return cells

    def spectral(gains: Gains, contact: Contact, spectrum: Spectrum) -> Metrics:
        loop = gains, contact, spectrum
        rms, effort, chatter = residual_rms(*loop), effort_rms(*loop), chatter_rms(*loop)
        peak = jnp.full_like(rms, jnp.nan)
        return Metrics(rms, peak, effort, chatter, peak, peak)

    over_scenarios = jax.vmap(spectral, in_axes=(None, None, 0))
    over_tissues = jax.vmap(over_scenarios, in_axes=(None, 0, None))
    found: Metrics = jax.vmap(over_tissues, in_axes=(0, 0, None))(controllers.gains, controllers.contacts, data.spectra)
    if data.correction is None:
        return found
    seen_by_it = found._replace(peak_to_peak=found.rms, peak_force=found.rms, peak_error=found.rms)
    corrected: Metrics = jax.tree.map(jnp.multiply, seen_by_it, data.correction)
    return corrected


def overshoot_of(controllers: Designed, kind: Kind) -> Float[Array, "starts stiffness"]:
    """How far the force of the linear loop exceeds a step of its reference, relative to the step; traceable."""
    quiet, one = jnp.zeros((1, STEP_SAMPLES)), jnp.ones((1, STEP_SAMPLES))
    wanted = jnp.ones((1, STEP_SAMPLES, HP_MAX if kind.world.preview else 1))
    gains = jax.vmap(lambda g: scalars(g, kind.world.preview))(controllers.gains)
    metrics, _ = over_cells(run, gains, controllers.contacts, jnp.zeros(1), AxisSignals(quiet, quiet, wanted, one))
    return jnp.maximum(metrics.peak_force[..., 0] - 1.0, 0.0)


class Judged(NamedTuple):
    """All starts judged by their goals, each (starts, …)."""

    controllers: Designed
    stable: Any
    margins: Standing
    cells: Metrics
    """(starts, stiffness, scenarios, 3)"""
    soft: dict[str, Array]
    """Normalised, (starts, stiffness, scenarios, 1 or 3) [-]."""
    risk: Any
    """Of the soft goals [-]."""
    hard: list[Array]
    """Hard goals on the runs at their worst [-]."""

    @property
    def log_risk(self) -> Array:
        """0 where unstable."""
        return jnp.log(jnp.where(self.stable & (self.risk > 0.0), self.risk, 1.0))

    @property
    def shortfall(self) -> list[Array]:
        """1 − 1/g per hard goal on the runs, and the headroom: at most 0 where met well inside [-]."""
        # What is met by far, such as the effort of a loop that stands still, has a slope of 0 and not of 0 · ∞.
        return [1.0 - 1.0 / jnp.maximum(goal, 0.5) + HEADROOM for goal in self.hard]


def judged(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> Judged:
    """Design, run and judge every start; traceable. Starts are innermost in the time loop, so they cost little."""
    space = Space(data.base, kind.axes)

    def one(vector: Array, limits: Any) -> tuple[Designed, Standing]:
        controller = designed(space.decode(vector, width), data, width, kind)
        return controller, standing(controller.found, limits, HEADROOM)

    controllers, margins = jax.vmap(one)(z, data.margins)
    stable = jnp.all(controllers.found.spectral_radius < 1.0, axis=1)
    # An unstable loop would run away and make even the unused slope NaN: it stands still instead.
    safe = controllers._replace(gains=jax.tree.map(lambda gain: _where(stable, gain, 0.0), controllers.gains))
    cells = cells_of(safe, data, kind)
    overshoot = overshoot_of(safe, kind) if OVERSHOOT in {*data.hard, *data.soft} else None

    def goals(limits: Mapping[str, Any]) -> dict[str, Array]:
        wide = {name: jnp.reshape(limit, (-1, 1, 1, 1)) for name, limit in limits.items()}
        return measured(cells, data.reference, overshoot, wide)

    soft, hard = goals(seen_soft(data)), goals({name: data.hard[name] for name in seen(data.hard, data)})
    per_scenario = jnp.concatenate([jnp.moveaxis(goal, 2, 1).reshape(*goal.shape[::2], -1) for goal in _wide(soft)], 2)
    risk = kind.risk.over(soft_worst(per_scenario))
    return Judged(controllers, stable, margins, cells, soft, risk, [jnp.max(g, axis=(1, 2, 3)) for g in hard.values()])


def look(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> tuple[Float[Array, " starts"], Any]:
    """Loss of every start; traceable.

    Returns:
        Loss [-]; and the fields of `Values` after the gradient.
    """
    found = judged(z, data, width, kind)
    missed = sum((jnp.maximum(value, 0.0) for value in found.shortfall), jnp.zeros(len(z)))
    loss = found.log_risk + PENALTY * (found.margins.violation + jnp.where(found.stable, missed, 0.0))

    def where_stable(value: Array) -> Array:
        return _where(found.stable, value, jnp.nan)

    per_tissue = jnp.stack([jnp.max(goal, axis=(2, 3)) for goal in found.soft.values()])
    worst_soft = [jnp.max(goal, axis=(1, 2, 3)) for goal in found.soft.values()]
    at_worst = [jnp.max(found.margins.normalised, axis=2)] + [goal[:, None] for goal in found.hard]
    return loss, (
        where_stable(found.risk),
        where_stable(jnp.max(found.cells.rms, axis=(1, 2, 3))),
        jnp.argmax(jnp.max(per_tissue, axis=0), axis=1),
        found.controllers.found.M_s,
        jnp.where(found.stable[:, None], jnp.concatenate(at_worst, axis=1), jnp.inf),
        where_stable(jnp.stack(worst_soft, axis=1)),
        jax.tree.map(where_stable, found.cells),
    )


def constrained(z: Float[Array, "starts size"], data: Data, kind: Kind) -> Float[Array, "starts values"]:
    """The same as a program with constraints: log risk, then what must be at most 0, whole horizons; traceable."""
    found = judged(z, data, 1.0, kind)
    margins = (1.0 + HEADROOM - found.margins.inverse).reshape(len(z), -1)
    runs = [jnp.where(found.stable, value, 1.0)[:, None] for value in found.shortfall]
    return jnp.concatenate([found.log_risk[:, None], margins, *runs], axis=1)


@partial(jax.jit, static_argnames=("kind",))
def measure(params: Params, data: Data, kind: Kind) -> Metrics:
    """What is measured of one controller, (stiffness, scenarios, 3)."""
    one = jax.tree.map(lambda leaf: leaf[None], designed(params, data, 1.0, kind))
    cells: Metrics = jax.tree.map(lambda leaf: leaf[0], cells_of(one, data, kind))
    return cells


def value_and_gradient(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> Values:
    """One look at all starts, in reverse mode; traceable."""

    def total(z: Array) -> tuple[Array, Any]:
        loss, rest = look(z, data, width, kind)
        return jnp.sum(loss), (loss, *rest)

    (_, (loss, *rest)), gradient = jax.value_and_grad(total, has_aux=True)(z)
    return Values(loss, gradient, *rest)


def value_alone(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> Values:
    """The same look without the slopes, which are NaN; traceable."""
    loss, rest = look(z, data, width, kind)
    return Values(loss, jnp.full_like(z, jnp.nan), *rest)


def seen(goals: Mapping[str, Any], data: Data) -> tuple[str, ...]:
    """The goals on the runs that a level can see: without time there are no peaks, only mean squares."""
    blind = data.spectra is not None and data.correction is None
    return tuple(name for name in goals if not (blind and name.startswith(PEAK)))


def seen_soft(data: Data) -> dict[str, Any]:
    """Limits of the soft goals that a level sees; where it would see no residual, the RMS stands in for its peaks."""
    found = {name: data.soft[name] for name in seen(data.soft, data)}
    if any(name.startswith("rms") for name in found):
        return found
    peaks = {name: limit for name, limit in data.soft.items() if name not in found}
    scale = {name: 1.0 if name.endswith("_ratio") else PEAK_TO_RMS for name in peaks}
    return found | {name.replace(PEAK, "rms"): limit / scale[name] for name, limit in peaks.items()}


def _where(stable: Array, value: Array, otherwise: float) -> Array:
    return jnp.where(stable.reshape(-1, *(1,) * (value.ndim - 1)), value, otherwise)


def _wide(goals: Mapping[str, Array]) -> list[Array]:
    """Goals with the same number of scenarios: the overshoot has one for all."""
    scenarios = max(goal.shape[2] for goal in goals.values())
    return [jnp.broadcast_to(goal, (*goal.shape[:2], scenarios, goal.shape[3])) for goal in goals.values()]
