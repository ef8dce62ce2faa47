"""What is minimised: the soft goals over tissues and scenarios, the hard ones held, and its gradient."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.closed_loops import ClosedLoops, close_loops
from jaxmpc.engine.registry import ENGINES
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


class Values(NamedTuple):
    """What one evaluation of all starts gives, each (starts, …)."""

    loss: Any
    gradient: Any
    score: Any
    """Risk of the soft goals [-]; NaN where unstable, or a run was lost."""
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


class GoalEvaluation(NamedTuple):
    """All starts held against their goals, each (starts, …)."""

    judged: Margins
    """(starts, judged_at)"""
    stable: Any
    margins: MarginGoals
    cells: Metrics
    """(starts, stiffness, scenarios, 3)"""
    soft: dict[str, Array]
    """Normalised, (starts, stiffness, scenarios, 1 or 3) [-]."""
    risk: Any
    """Risk over the scenarios of the soft goals [-]."""
    hard: list[Array]
    """Hard goals on the runs at their worst, (starts, 1); of a family on each tissue, (starts, stiffness) [-]."""

    @property
    def log_risk(self) -> Array:
        """0 where unstable, NaN where a run was lost."""
        return jnp.log(jnp.where(self.stable & (self.risk != 0.0), self.risk, 1.0))

    @property
    def shortfall(self) -> list[Array]:
        """1 − 1/g per hard goal on the runs, and the headroom: at most 0 where met well inside [-]."""
        # What is met by far, such as the effort of a loop that stands still, has a slope of 0 and not of 0 · ∞.
        return [1.0 - 1.0 / jnp.maximum(goal, 0.5) + HEADROOM for goal in self.hard]

    @property
    def loss(self) -> Array:
        """Log risk, and the price of what hard goals miss [-]."""
        missed = sum(
            (jnp.mean(jnp.maximum(value, 0.0), axis=1) for value in self.shortfall), jnp.zeros(len(self.stable))
        )
        return self.log_risk + PENALTY * (self.margins.violation + jnp.where(self.stable, missed, 0.0))


def evaluate_vectors(
    z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure
) -> GoalEvaluation:
    """Design, run and judge every start; traceable. Starts are innermost in the time loop, so they cost little."""
    space = SearchSpace(data.base, structure.axes)
    params = jax.vmap(lambda vector: space.decode(vector, width))(z)
    return evaluate_goals(close_loops(params, data.scene.stiffness, data.scene.path, width), data, structure)


def evaluate_goals(loops: ClosedLoops, data: Data, structure: ProblemStructure) -> GoalEvaluation:
    """Run and judge closed loops; traceable."""
    judged = judged_margins(loops, data)
    stable = jnp.all(judged.spectral_radius < 1.0, axis=1)
    limits = {name: jnp.broadcast_to(limit, stable.shape) for name, limit in data.margins.items()}
    margins = jax.vmap(lambda found, limits: margin_goals(found, limits, HEADROOM))(judged, limits)
    # An unstable loop would run away and make even the unused slope NaN: it stands still instead.
    safe = loops._replace(gains=_still(stable, loops.gains))
    cells = cells_of(safe, data, structure)
    overshoot = overshoot_of(safe, data, structure) if OVERSHOOT in {*data.hard, *data.soft} else None

    def goals(limits: Mapping[str, Any]) -> dict[str, Any]:
        wide = {name: jnp.reshape(limit, (-1, 1, 1, 1)) for name, limit in limits.items()}
        return run_goals(cells, data.reference, overshoot, wide)

    soft, hard = goals(visible_soft(data)), goals({name: data.hard[name] for name in visible_goals(data.hard, data)})
    cells_last = jnp.concatenate(_wide(soft), axis=3)
    if data.believed is None:
        per_scenario = jnp.moveaxis(cells_last, 2, 1).reshape(*cells_last.shape[::2], -1)
        risk = structure.risk.over(soft_worst(per_scenario))
        missed = [greatest(goal.reshape(len(goal), 1, -1)) for goal in hard.values()]
    else:
        # A knot serves its own tissue, so each counts: the worst alone would leave all others where they are.
        risk = _geometric_mean(structure.risk.over(soft_worst(cells_last)))
        missed = [greatest(goal.reshape(*goal.shape[:2], -1)) for goal in hard.values()]
    return GoalEvaluation(judged, stable, margins, cells, soft, risk, missed)


def loss_of(
    z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure
) -> tuple[Float[Array, " starts"], Any]:
    """Loss of every start; traceable.

    Returns:
        Loss [-]; and the fields of `Values` after the gradient.
    """
    found = evaluate_vectors(z, data, width, structure)

    def where_stable(value: Array) -> Array:
        return _where(found.stable, value, jnp.nan)

    per_tissue = jnp.stack([jnp.max(goal, axis=(2, 3)) for goal in found.soft.values()])
    worst_soft = [jnp.max(goal, axis=(1, 2, 3)) for goal in found.soft.values()]
    at_worst = [jnp.max(found.margins.normalised, axis=2)] + [
        jnp.max(goal, axis=1, keepdims=True) for goal in found.hard
    ]
    return found.loss, (
        where_stable(found.risk),
        where_stable(jnp.max(found.cells.rms, axis=(1, 2, 3))),
        jnp.argmax(jnp.max(per_tissue, axis=0), axis=1),
        found.judged.M_s,
        jnp.where(found.stable[:, None], jnp.concatenate(at_worst, axis=1), jnp.inf),
        where_stable(jnp.stack(worst_soft, axis=1)),
        jax.tree.map(where_stable, found.cells),
    )


def constrained(
    z: Float[Array, "starts size"], data: Data, structure: ProblemStructure
) -> Float[Array, "starts values"]:
    """The same as a program with constraints: log risk, then what must be at most 0, whole horizons; traceable."""
    found = evaluate_vectors(z, data, 1.0, structure)
    margins = (1.0 + HEADROOM - found.margins.inverse).reshape(len(z), -1)
    runs = [jnp.where(found.stable[:, None], value, 1.0) for value in found.shortfall]
    return jnp.concatenate([found.log_risk[:, None], margins, *runs], axis=1)


def value_and_gradient(z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure) -> Values:
    """Value and gradient of all starts, in reverse mode where the engine has it, else in forward mode; traceable."""
    if "reverse" not in ENGINES[structure.world.engine].modes:
        return _in_forward_mode(z, data, width, structure)

    def total(z: Array) -> tuple[Array, Any]:
        loss, rest = loss_of(z, data, width, structure)
        return jnp.sum(loss), (loss, *rest)

    (_, (loss, *rest)), gradient = jax.value_and_grad(total, has_aux=True)(z)
    return Values(loss, gradient, *rest)


def _in_forward_mode(z: Array, data: Data, width: Any, structure: ProblemStructure) -> Values:
    """A start's loss is its own, so each parameter is one direction for all starts at once."""

    def along(direction: Array) -> tuple[Array, Array, Any]:
        moving = jnp.broadcast_to(direction, z.shape)
        found: tuple[Array, Array, Any] = jax.jvp(
            lambda z: loss_of(z, data, width, structure), (z,), (moving,), has_aux=True
        )
        return found

    loss, slopes, rest = jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(z.shape[1], dtype=z.dtype))
    return Values(loss, slopes.T, *rest)


def value_alone(z: Float[Array, "starts size"], data: Data, width: Any, structure: ProblemStructure) -> Values:
    """The same without the slopes, which are NaN; traceable."""
    loss, rest = loss_of(z, data, width, structure)
    return Values(loss, jnp.full_like(z, jnp.nan), *rest)


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


def _where(stable: Array, value: Array, otherwise: float) -> Array:
    return jnp.where(stable.reshape(-1, *(1,) * (value.ndim - 1)), value, otherwise)


def _still(stable: Array, gains: Gains) -> Gains:
    """Gains of zero where a loop is unstable; the input gain and the places of the knots stay, by which one divides."""
    family = gains.schedule
    none: Gains = jax.tree.map(lambda gain: _where(stable, gain, 0.0), gains._replace(schedule=None))
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
