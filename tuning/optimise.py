"""The descent: all starts side by side, horizons first soft and then whole; the best that holds its goals is kept."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from jaxmpc.progress import progress
from jaxmpc.scene import world_of
from tuning.objective import Data, Kind, Values, scene_over_seeds, value_and_gradient
from tuning.spec import TuneSpec
from tuning.state import State, load, save

CLIP = 1.0
"""Largest norm of one start's gradient: one that grazes instability must not fill Adam's memory."""
SCREENED = 16
"""Random points looked at for each start."""
SOFTEST = 8.0
"""Width of the horizons' mask at the beginning [samples]."""
ANNEALED = 0.5
"""Share of the steps taken with soft horizons; the rest polishes at whole ones."""
FINAL_RATE = 0.03
"""Learning rate at the end of each phase, relative to its beginning."""
WORTH = 1e-4
"""Relative gain below which a step counts as none."""
PATIENCE = 30
"""Polishing steps without gain until it stops."""
SAVE_EVERY = 5.0
"""Seconds between two saved states."""

Look = Callable[[Any, float], Values]


def schedule(steps: int, soft: bool, rate: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Mask width [samples] and learning rate of every look, and the look at which polishing begins.

    Look 0 sees the starts as they are, with whole horizons, and moves nothing; so the result is never
    worse than a feasible start.
    """
    annealed = round(ANNEALED * steps) if soft else 0
    widths, rates = [np.ones(1)], [np.zeros(1)]
    for length, width in ((annealed, SOFTEST), (steps - annealed, 1.0)):
        along = np.arange(length) / max(length, 1)
        widths.append(width ** (1.0 - along))
        rates.append(rate * (FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + np.cos(np.pi * along))))
    return np.concatenate(widths), np.concatenate(rates), 1 + annealed


def optimiser() -> tuple[Callable[[Any], Any], Callable[..., Any]]:
    """Adam with its gradient clipped, per start; a start whose gradient is not finite stays where it is."""
    chain = optax.chain(optax.clip_by_global_norm(CLIP), optax.scale_by_adam())

    def one(z: Array, memory: Any, gradient: Array, rate: Array) -> tuple[Array, Any, Array]:
        usable = jnp.all(jnp.isfinite(gradient))
        direction, moved = chain.update(jnp.where(usable, gradient, 0.0), memory)
        memory = jax.tree.map(lambda new, old: jnp.where(usable, new, old), moved, memory)
        return jnp.where(usable, z - rate * direction, z), memory, usable

    return jax.jit(jax.vmap(chain.init)), jax.jit(jax.vmap(one, in_axes=(0, 0, 0, None)))


def starts_of(spec: TuneSpec, look: Look) -> np.ndarray:
    """The given parameters first, then the most promising of many random ones: there is more than one valley."""
    space, count = spec.space, spec.tune.starts
    drawn = space.draw(SCREENED * count, spec.tune.seed)
    losses = np.concatenate([look(part, 1.0).loss for part in np.split(drawn, SCREENED)])
    order = np.argsort(losses, stable=True)
    return np.concatenate([space.encode(spec.params)[None], drawn[order[: count - 1]]])


def looker(spec: TuneSpec) -> Look:
    """Value and gradient of a spec's starts as f(z, width)."""
    experiment, tune = spec.experiment, spec.tune
    scene = scene_over_seeds(experiment, tune.train_seeds, tune.duration, tune.settle)
    data = jax.tree.map(jnp.asarray, Data(scene, spec.params, dict(spec.goals)))
    kind = Kind(
        axes=spec.space.axes,
        ideal_goals=spec.ideal,
        world=world_of(experiment),
        precision=tune.precision,
    )
    return lambda z, width: Values(*map(np.asarray, value_and_gradient(z, data, width, kind)))


def descend(spec: TuneSpec, folder: Path | None, show: bool) -> State:
    """Run the descent, or continue it from the state in its folder.

    Args:
        spec: What to tune.
        folder: Where the state is kept; None keeps none.
        show: Whether to show progress.
    """
    look, space = looker(spec), spec.space
    soft = any(axis.name in ("Hp", "Hu") for axis in space.axes)
    widths, rates, polish = schedule(spec.tune.steps, soft, spec.tune.learning_rate)
    begin, update = optimiser()
    z = starts_of(spec, look)
    state = State.new(z, begin(jnp.asarray(z)), len(widths), len(spec.experiment.stiffness))
    if folder is not None:
        state = load(folder, spec.digest, state)
    saved = time.monotonic()
    with progress("tune", len(widths), "steps", show) as tick:
        while state.look < len(widths) and not state.stalled(PATIENCE, polish):
            i = state.look
            if i == polish:
                # What Adam remembers of soft horizons would push the whole ones around.
                state.memory = begin(jnp.asarray(state.z))
            values = look(state.z, float(widths[i]))
            state.record(values, exact=widths[i] == 1.0, worth=WORTH)
            moved, state.memory, usable = update(state.z, state.memory, values.gradient, rates[i])
            state.z = np.asarray(moved)
            state.skipped += ~np.asarray(usable)
            state.look += 1
            tick(state.look, state.note())
            if folder is not None and time.monotonic() - saved > SAVE_EVERY:
                save(folder, spec.digest, state)
                saved = time.monotonic()
    if folder is not None:
        save(folder, spec.digest, state)
    return state
