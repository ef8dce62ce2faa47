"""What is minimised: the worst residual over tissue, axis and motion, with the margins held, and its gradient."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import msgspec
from jaxtyping import Array, Float

from jaxmpc.engine.rollout import scalars
from jaxmpc.experiment import Experiment
from jaxmpc.law.cascade import Gains
from jaxmpc.params import Params
from jaxmpc.scene import Scene, World, run_cells, scene_of, side_by_side
from jaxmpc.stability import Margins, margins_one
from jaxmpc.stability.loop import SENSOR_CUTOFF_HZ, VELOCITY_CUTOFF, contact_of
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import Contact, hertz
from tuning.goals import standing
from tuning.transforms import Axis, Space

ORDER = 24
"""Order of the mean that stands for the worst case: equal to it where all cells are, 10 % below for one of 18 alone."""
PENALTY = 10.0
"""Price of a violation in units of log residual: above its Lagrange multiplier (some 2) the penalty is exact."""
HEADROOM = 0.002
"""How far inside their limits the goals are aimed at, so that the last steps do not hover outside [-]."""


class Values(NamedTuple):
    """What one look at all starts gives, each (starts, …)."""

    loss: Any
    gradient: Any
    worst: Any
    """Largest residual RMS over stiffness, axis and seed; NaN where unstable [N]."""
    M_s: Any
    """Peak sensitivity per stiffness [-]."""
    normalised: Any
    """Goals, (starts, goals, stiffness); met at 1 and below [-]."""


def scene_over_seeds(experiment: Experiment, seeds: Sequence[int], duration: float, settle: float) -> Scene:
    """An experiment on several motion seeds at once, as if each seed had three axes of its own."""
    cut = msgspec.structs.replace(experiment, duration=duration, settle=settle)
    return side_by_side([scene_of(cut.with_seed(seed)) for seed in seeds])


def soft_worst(residuals: Float[Array, "starts ..."]) -> Float[Array, " starts"]:
    """Mean of order `ORDER` over all but the first dimension: a maximum whose slope moves smoothly between cells."""
    cells = residuals.reshape(len(residuals), -1)
    highest = jax.lax.stop_gradient(jnp.max(cells, axis=1))
    return highest * jnp.mean((cells / highest[:, None]) ** ORDER, axis=1) ** (1.0 / ORDER)


def judged_contact(K_s: Any, K2: Any, scene: Scene, ideal: bool) -> Contact:
    """The world in which `jaxmpc.margins` judges: it runs through the WAM's filters or, if ideal, through none."""
    sensor = 0.0 if ideal else hertz(SENSOR_CUTOFF_HZ)
    return contact_of(K_s, K2, scene.T_s, scene.delay, ideal, VELOCITY_CUTOFF, sensor)


def design_and_goal_margins(
    params: Params, scene: Scene, width: Any, *, ideal_run: bool, ideal_goals: bool
) -> tuple[Gains, Contact, Margins]:
    """Gains, the worlds to run in, and the margins to judge by; the latter as `jaxmpc.margins` defines them."""
    gains, residual = design_one(params, scene.T_s, width)

    def one(K_s: Any) -> tuple[Contact, Margins]:
        world = contact_of(
            K_s, params.K2, scene.T_s, scene.delay, ideal_run, scene.velocity_cutoff, scene.sensor_cutoff
        )
        judged = judged_contact(K_s, params.K2, scene, ideal_goals)
        return world, margins_one(gains, judged, ideal_goals, residual)

    contacts, found = jax.vmap(one)(scene.stiffness)
    return gains, contacts, found


class Kind(NamedTuple):
    """What needs a program of its own; all else is data."""

    axes: tuple[Axis, ...]
    ideal_goals: bool
    world: World
    precision: str


class Data(NamedTuple):
    """What a program takes besides the starts."""

    scene: Scene
    base: Params
    """Values of what is frozen."""
    limits: Mapping[str, Any]
    """Limit per goal."""


def look(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> tuple[Float[Array, " starts"], Any]:
    """Loss of every start; traceable. Starts are innermost in the time loop, so they cost little.

    Returns:
        Loss [-]; and the worst residual [N], M_s and the normalised goals, as in `Values`.
    """
    scene, space = data.scene, Space(data.base, kind.axes)

    def design(vector: Array) -> Any:
        params = space.decode(vector, width)
        gains, contacts, found = design_and_goal_margins(
            params, scene, width, ideal_run=kind.world.ideal, ideal_goals=kind.ideal_goals
        )
        return scalars(gains, kind.world.preview), params.K2, contacts, found, standing(found, data.limits, HEADROOM)

    gains, K2, contacts, found, goals = jax.vmap(design)(z)
    stable = jnp.all(found.spectral_radius < 1.0, axis=1)
    # An unstable loop would run away and make even the unused slope NaN: it stands still instead.
    gains = jax.tree.map(lambda gain: jnp.where(stable, gain, 0.0), gains)
    ran = run_cells(kind.world, gains, K2, contacts, scene, kind.precision)
    residuals = ran.metrics.rms.astype(jnp.float64)
    loss = jnp.where(stable, jnp.log(soft_worst(residuals)), 0.0) + PENALTY * goals.violation
    worst = jnp.where(stable, jnp.max(residuals, axis=(1, 2)), jnp.nan)
    return loss, (worst, found.M_s, goals.normalised)


@partial(jax.jit, static_argnames=("kind",))
def value_and_gradient(z: Float[Array, "starts size"], data: Data, width: Any, kind: Kind) -> Values:
    """One look at all starts, in reverse mode; compiled once per `kind` and shapes."""

    def total(z: Array) -> tuple[Array, Any]:
        loss, rest = look(z, data, width, kind)
        return jnp.sum(loss), (loss, *rest)

    (_, (loss, *rest)), gradient = jax.value_and_grad(total, has_aux=True)(z)
    return Values(loss, gradient, *rest)
