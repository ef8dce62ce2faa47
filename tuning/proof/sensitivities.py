"""How much the tuned controller depends on each of its parameters, tissue by tissue."""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmpc.xla.place import on_cpu
from jaxmpc.xla.precision import in_float64
from tuning.job.space import SearchSpace
from tuning.proof.found import FoundController
from tuning.proof.gradients import SCORE, Slope, on_tissue, sloped, slopes


class Sensitivities(NamedTuple):
    """Sensitivities of the tuned controller, on each tissue as if there were no other."""

    metrics: tuple[str, ...]
    """The score, and the margins that are hard goals."""
    parameters: tuple[str, ...]
    """The free ones; a diagonal counts as a whole."""
    values: Float[np.ndarray, "metrics stiffness"]
    """Score and normalised goals [-]; NaN where unstable."""
    slopes: Float[np.ndarray, "metrics parameters stiffness"]
    """d log metric / d log parameter [-]; of a horizon, the quotient of differences over a sample to either side."""


@in_float64
def sensitivities(result: FoundController) -> Sensitivities:
    """Exact gradients of the loop, on the arm of its corrected spectra; see `tuning.proof.gradients`."""
    space, z = result.spec.space, vector_of(result)
    problem = sloped(result, z)
    beside, apart = _beside(space, z)
    metrics = (SCORE, *result.spec.margin_goals)
    tissues = range(len(result.spec.experiment.stiffness))
    found = [slopes(on_tissue(problem, i), z, len(result.state.z), beside) for i in tissues]
    values = np.array([[tissue[name].value for tissue in found] for name in metrics])
    per_unit = log_slopes(space, z)
    rows = [[_per_parameter(space, tissue[name], per_unit, apart) for tissue in found] for name in metrics]
    names = tuple(axis.name for axis in space.axes)
    return Sensitivities(metrics, names, values, np.moveaxis(np.array(rows), 1, 2))


def vector_of(result: FoundController) -> Float[np.ndarray, " size"]:
    """The vector that the tuned controller stands for, among those that the last step has kept."""
    state, space = result.state, result.spec.space
    kept = np.concatenate([state.best_z[np.isfinite(state.best)], state.closest_z])
    wanted = [np.broadcast_to(axis.of(result.params), axis.size) for axis in space.axes]
    distance = np.abs(np.log(space.values(kept) / np.concatenate(wanted)))
    # Rounding has moved the horizons: they decide only where nothing else does.
    distance[:, space.whole] *= 1e-6
    nearest: np.ndarray = kept[int(np.argmin(distance.max(axis=1)))]
    return nearest


@on_cpu()
def log_slopes(space: SearchSpace, z: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
    """d log parameter / dz of each unconstrained number; 0 at a bound."""
    one = partial(space.decode, width=2.0)
    # Compiled as one: operation by operation it takes longer than all else that is asked of a tissue.
    values, slopes = jax.device_get(jax.jit(lambda at: jax.jvp(one, (at,), (jnp.ones_like(at),)))(z))
    relative = [np.broadcast_to(a.of(slopes) / a.of(values), a.size) for a in space.axes]
    return np.concatenate(relative)


def _beside(space: SearchSpace, z: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
    """Vectors with each free horizon a sample shorter and longer, in pairs, and how far apart its logarithms are."""
    params = space.exact(z)
    ends = np.cumsum([axis.size for axis in space.axes])
    rows, apart = [], {}
    for axis, end in zip(space.axes, ends, strict=True):
        if not axis.whole:
            continue
        owners = [params.knots[i] for i in axis.knots] or [params]
        longest_Hu, shortest_Hp = max(float(p.Hu) for p in owners), min(float(p.Hp) for p in owners)
        low, high = (longest_Hu, axis.high) if axis.parameter == "Hp" else (axis.low, min(axis.high, shortest_Hp))
        pair = max(axis.of(params) - 1.0, axis.low, low), min(axis.of(params) + 1.0, high)
        for value in pair:
            rows.append(z.copy())
            rows[-1][end - 1] = float(axis.unconstrained(value))
        apart[axis.name] = np.log(pair[1] / pair[0])
    return np.array(rows).reshape(len(rows), len(z)), apart


def _per_parameter(space: SearchSpace, slope: Slope, per_unit: np.ndarray, apart: Mapping[str, float]) -> np.ndarray:
    """d log metric / d log parameter, (parameters,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # A parameter at its bound has no slope to divide by; it cannot move either.
        relative = np.nan_to_num(slope.gradient / per_unit, posinf=0.0, neginf=0.0)
        steps = np.array(list(apart.values()))
        quotients = np.where(steps == 0.0, 0.0, np.log(slope.beside[1::2] / slope.beside[::2]) / steps)
    summed = np.add.reduceat(relative, np.cumsum([0, *(axis.size for axis in space.axes[:-1])]))
    # NaN where a horizon beside it is unstable: that is no slope, and not none.
    summed[[axis.whole for axis in space.axes]] = np.where(np.isfinite(quotients), quotients, np.nan)
    return summed if np.isfinite(slope.value) else np.full_like(summed, np.nan)
