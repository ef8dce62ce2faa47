"""All starts held against their goals: margins first, which tell what is stable, and then what stable loops did."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmpc.closed_loops import ClosedLoops, close_loops
from jaxmpc.law.gains import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.stability import Margins
from jaxmpc.xla.extremes import greatest
from tuning.job.goals import OVERSHOOT, RATIO, RUN_GOALS, MarginGoals, margin_goals, run_goals
from tuning.job.risk import soft_worst
from tuning.job.space import SearchSpace
from tuning.objective.measures import Data, ProblemStructure, cells_of, judged_margins, overshoot_of

PENALTY = 10.0
"""Price of a violation in units of log residual: above its Lagrange multiplier (some 2) the penalty is exact."""
HEADROOM = 0.002
"""How far inside their limits the goals are aimed at, so that the last steps do not hover outside [-]."""


class MarginEvaluation(NamedTuple):
    """Margins held against their goals, each (starts, …)."""

    margins: Margins
    """(starts, judged_at)"""
    stable: Bool[Array, " starts"]
    goals: MarginGoals

    @property
    def loss(self) -> Array:
        """Price of what the goals miss [-]."""
        return jnp.asarray(PENALTY * self.goals.violation)

    @property
    def worst(self) -> Array:
        """Each goal at its worst, (starts, goals) [-]; ∞ where unstable."""
        return where(self.stable, jnp.max(self.goals.normalised, axis=2), jnp.inf)


class RunEvaluation(NamedTuple):
    """Runs held against their goals, each (starts, …)."""

    stable: Bool[Array, " starts"]
    """As the margins say."""
    cells: Metrics
    """(starts, stiffness, scenarios, 3)"""
    soft: dict[str, Array]
    """Normalised, (starts, stiffness, scenarios, 1 or 3) [-]."""
    risk: Any
    """Risk over the scenarios of the soft goals [-]."""
    hard: list[Array]
    """Hard goals at their worst, (starts, 1); of a family on each tissue, (starts, stiffness) [-]."""

    @property
    def log_risk(self) -> Array:
        """0 where unstable, NaN where a run was lost."""
        return jnp.log(jnp.where(self.stable & (self.risk != 0.0), self.risk, 1.0))

    @property
    def shortfall(self) -> list[Array]:
        """1 − 1/g per hard goal, and the headroom: at most 0 where met well inside [-]."""
        # What is met by far, such as the effort of a loop that stands still, has a slope of 0 and not of 0 · ∞.
        return [1.0 - 1.0 / jnp.maximum(goal, 0.5) + HEADROOM for goal in self.hard]

    @property
    def loss(self) -> Array:
        """Log risk, and the price of what hard goals miss [-]."""
        missed = sum(
            (jnp.mean(jnp.maximum(value, 0.0), axis=1) for value in self.shortfall), jnp.zeros(len(self.stable))
        )
        return self.log_risk + PENALTY * jnp.where(self.stable, missed, 0.0)

    @property
    def worst(self) -> Array:
        """Each hard goal at its worst, (starts, goals) [-]; ∞ where unstable."""
        found = [jnp.max(goal, axis=1, keepdims=True) for goal in self.hard]
        return where(self.stable, jnp.concatenate([jnp.zeros((len(self.stable), 0)), *found], axis=1), jnp.inf)


def loops_of(z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure) -> ClosedLoops:
    """The controllers that vectors stand for, their loops closed; traceable."""
    space = SearchSpace(data.base, structure.axes)
    params = jax.vmap(lambda vector: space.decode(vector, width))(z)
    return close_loops(params, data.scene.stiffness, data.scene.path, width)


def judge(loops: ClosedLoops, data: Data) -> MarginEvaluation:
    """Judge the margins of closed loops; traceable."""
    margins = judged_margins(loops, data)
    stable = jnp.all(margins.spectral_radius < 1.0, axis=1)
    limits = {name: jnp.broadcast_to(limit, stable.shape) for name, limit in data.margins.items()}
    return MarginEvaluation(
        margins, stable, jax.vmap(lambda found, limits: margin_goals(found, limits, HEADROOM))(margins, limits)
    )


def at_rest(loops: ClosedLoops, stable: Bool[Array, " starts"]) -> ClosedLoops:
    """Loops of which unstable ones stand still: they would run away, and make even the unused slope NaN."""
    return loops._replace(gains=_still(stable, loops.gains))


def run(loops: ClosedLoops, stable: Bool[Array, " starts"], data: Data, structure: ProblemStructure) -> RunEvaluation:
    """Run closed loops and judge what they did; traceable. Starts are innermost in the time loop, so they cost little.

    Args:
        loops: The controllers.
        stable: Whether they are, as their margins say (`judge`).
        data: The rest.
        structure: What the program is of.
    """
    safe = at_rest(loops, stable)
    soft_limits, hard_limits = visible_soft(data), {name: data.hard[name] for name in visible_goals(data.hard, data)}
    metrics = sorted({RUN_GOALS[name].metric.name for name in {*soft_limits, *hard_limits} - {OVERSHOOT}})
    cells = cells_of(safe, data, structure._replace(world=structure.world._replace(slopes=tuple(metrics))))
    overshoot = overshoot_of(safe, data, structure) if OVERSHOOT in {*data.hard, *data.soft} else None

    def goals(limits: Mapping[str, Any]) -> dict[str, Any]:
        wide = {name: jnp.reshape(limit, (-1, 1, 1, 1)) for name, limit in limits.items()}
        return run_goals(cells, data.reference, overshoot, wide)

    soft, hard = goals(soft_limits), goals(hard_limits)
    cells_last = jnp.concatenate(_wide(soft), axis=3)
    if data.believed is None:
        per_scenario = jnp.moveaxis(cells_last, 2, 1).reshape(*cells_last.shape[::2], -1)
        risk = structure.risk.over(soft_worst(per_scenario))
        missed = [greatest(goal.reshape(len(goal), 1, -1)) for goal in hard.values()]
    else:
        # A knot serves its own tissue, so each counts: the worst alone would leave all others where they are.
        risk = _geometric_mean(structure.risk.over(soft_worst(cells_last)))
        missed = [greatest(goal.reshape(*goal.shape[:2], -1)) for goal in hard.values()]
    return RunEvaluation(stable, cells, soft, risk, missed)


def visible_goals(goals: Mapping[str, Any], data: Data) -> tuple[str, ...]:
    """The goals on the runs that can be seen: without time there are no peaks, only mean squares."""
    blind = data.spectra is not None and data.correction is None
    return tuple(name for name in goals if not (blind and name in RUN_GOALS and not RUN_GOALS[name].metric.spectral))


def visible_soft(data: Data) -> dict[str, Any]:
    """Limits of the soft goals that can be seen; where no residual would be, the RMS stands in for the others."""
    found = {name: data.soft[name] for name in visible_goals(data.soft, data)}
    if any(name in RUN_GOALS and RUN_GOALS[name].metric.name == "rms" for name in found):
        return found
    for name, limit in data.soft.items():
        if name not in found:
            metric, part = RUN_GOALS[name]
            found[name.replace(metric.name, "rms")] = limit / (1.0 if part == RATIO else metric.crest)
    return found


def where(stable: Array, value: Array, otherwise: float) -> Array:
    """What each start has, (starts, …), or something else for those that are unstable."""
    return jnp.where(stable.reshape(-1, *(1,) * (value.ndim - 1)), value, otherwise)


def _still(stable: Array, gains: Gains) -> Gains:
    """Gains of zero where a loop is unstable; the input gain and the places of the knots stay, by which one divides."""
    family = gains.schedule
    none: Gains = jax.tree.map(lambda gain: where(stable, gain, 0.0), gains._replace(schedule=None))
    found = none._replace(input_gain=gains.input_gain)
    if family is None:
        return found
    knots = tuple(knot._replace(gains=_still(stable, knot.gains)) for knot in family.knots)
    return found._replace(schedule=family._replace(knots=knots))


def _geometric_mean(values: Float[Array, "starts stiffness"]) -> Float[Array, " starts"]:
    """0 where one is, NaN where one is that, whatever the others are."""
    some = jnp.all(values != 0.0, axis=1)
    mean = jnp.exp(jnp.mean(jnp.log(jnp.where(values == 0.0, 1.0, values)), axis=1))
    return jnp.where(some | jnp.isnan(mean), mean, 0.0)


def _wide(goals: Mapping[str, Array]) -> list[Array]:
    """Goals with the same number of scenarios: the overshoot has one for all."""
    scenarios = max(goal.shape[2] for goal in goals.values())
    return [jnp.broadcast_to(goal, (*goal.shape[:2], scenarios, goal.shape[3])) for goal in goals.values()]
