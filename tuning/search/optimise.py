"""The descent: all starts side by side, horizons first soft and then whole; the best of each is kept."""

import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from jaxmpc.terminal.progress import progress
from jaxmpc.xla.place import on_cpu
from tuning.job.spec import TuneSpec
from tuning.objective.problem import Problem
from tuning.search.state import NAME, SearchState, load, save

CLIP = 1.0
"""Largest norm of one start's gradient: one that grazes instability must not fill Adam's memory."""
SOFTEST = 8.0
"""Width of the horizons' mask at the beginning [samples]."""
ANNEALED = 0.5
"""Share of the steps taken with soft horizons; the rest polishes at whole ones."""
POLISHING = 0.1
"""Learning rate of polishing, relative to that of the soft horizons: it begins in a valley already."""
FINAL_RATE = 0.03
"""Learning rate at the end of each phase, relative to its beginning."""
WORTH = 1e-4
"""Relative gain below which a step counts as none."""
PATIENCE = 30
"""Polishing steps without gain until it stops."""
SAVE_EVERY = 5.0
"""Seconds between two saved states."""


class Schedule(NamedTuple):
    """What changes from iteration to iteration."""

    widths: np.ndarray
    """Widths of the horizons' mask [samples]."""
    rates: np.ndarray
    """Learning rates, one a step."""
    polish: int
    """The iteration at which polishing begins."""
    patience: int = PATIENCE
    """Iterations without gain until it stops."""


def schedule(steps: int, soft: bool, rate: float) -> Schedule:
    """A descent of so many steps, half of them with soft horizons if wanted.

    Iteration 0 sees the starts as they are, with whole horizons, and moves nothing; so the result is never
    worse than a feasible start.
    """
    annealed = round(ANNEALED * steps) if soft else 0
    widths, rates = [np.ones(1)], [np.zeros(1)]
    slower = POLISHING if annealed else 1.0
    for length, width, highest in ((annealed, SOFTEST, rate), (steps - annealed, 1.0, slower * rate)):
        along = np.arange(length) / max(length, 1)
        widths.append(width ** (1.0 - along))
        rates.append(highest * (FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + np.cos(np.pi * along))))
    return Schedule(np.concatenate(widths), np.concatenate(rates), 1 + annealed)


@cache
def optimiser() -> tuple[Callable[[Any], Any], Callable[..., Any]]:
    """Adam with its gradient clipped, per start; a start whose gradient is not finite stays where it is."""
    chain = optax.chain(optax.clip_by_global_norm(CLIP), optax.scale_by_adam())

    def one(z: Array, memory: Any, gradient: Array, rate: Array) -> tuple[Array, Any, Array]:
        usable = jnp.all(jnp.isfinite(gradient))
        direction, moved = chain.update(jnp.where(usable, gradient, 0.0), memory)
        memory = jax.tree.map(lambda new, old: jnp.where(usable, new, old), moved, memory)
        return jnp.where(usable, z - rate * direction, z), memory, usable

    # A few numbers, which a GPU would take longer to be asked for than to move.
    return on_cpu()(jax.jit(jax.vmap(chain.init))), on_cpu()(jax.jit(jax.vmap(one, in_axes=(0, 0, 0, None))))


def rehearse(starts: int, size: int) -> None:
    """Compile what moves so many starts."""
    begin, update = optimiser()
    z = np.zeros((starts, size))
    update(z, begin(z), z, np.float64(0.0))


def descend(
    spec: TuneSpec,
    problem: Problem,
    z: np.ndarray,
    plan: Schedule,
    folder: Path | None = None,
    name: str = NAME,
    show: bool = False,
    key: str | None = None,
) -> SearchState:
    """Run a descent, or continue it from the state in its folder.

    Args:
        spec: The job.
        problem: Its problem, by runs or by spectra.
        z: The starts, (starts, size).
        plan: What changes from iteration to iteration.
        folder: Where the state is kept; None keeps none.
        name: Under which name.
        show: Whether to show progress.
        key: What the state belongs to; None is the job.
    """
    key = key or spec.digest
    begin, update = optimiser()
    goals = len(spec.margin_goals) + len(problem.hard_goals), len(problem.soft_goals)
    state = SearchState.new(z, begin(z), len(plan.widths), goals)
    if folder is not None:
        state = load(folder, key, state, name)
    saved = time.monotonic()
    with progress(f"tune ({name_of(name)})", len(plan.widths), "steps", show) as tick:
        while state.iteration < len(plan.widths) and not state.stalled(plan.patience, plan.polish):
            i = state.iteration
            if i == plan.polish:
                # What Adam remembers of soft horizons would push the whole ones around.
                state.memory = begin(state.z)
            values = problem.differentiate(state.z, float(plan.widths[i]))
            state.record(values, plan.widths[i] == 1.0, WORTH, problem.hard_at(values.cells))
            moved, state.memory, usable = update(state.z, state.memory, values.gradient, plan.rates[i])
            state.z = np.asarray(moved)
            state.skipped += ~np.asarray(usable)
            state.iteration += 1
            tick(state.iteration, note(spec, state))
            if folder is not None and time.monotonic() - saved > SAVE_EVERY:
                save(folder, key, state, name)
                saved = time.monotonic()
    if folder is not None:
        save(folder, key, state, name)
    return state


def name_of(state: str) -> str:
    """The step that a state belongs to, from the name of its file."""
    return state.removesuffix(".npz").removeprefix("state").lstrip("-") or "state"


def note(spec: TuneSpec, state: SearchState) -> str:
    """One line for the progress display: goals, worst tissue and parameters of the leading start."""
    i, leader = state.iteration - 1, state.leader
    best = f"best {state.best.min():.3f}" if state.feasible else f"goals missed by × {state.closest.min():.2f}"
    tissue = spec.experiment.stiffness[int(np.nan_to_num(state.tissue[i, leader]))]
    values = spec.space.values(state.leader_z)
    named = ", ".join(f"{name} {value:.3g}" for name, value in list(zip(spec.space.names, values, strict=True))[:8])
    skips = f", {state.skipped.sum()} steps skipped" if state.skipped.any() else ""
    now = f"RMS {1e3 * state.worst[i, leader]:.1f} mN, worst at {tissue:g} N/m, M_s {state.M_s[i, leader]:.2f}"
    return f"{best}; {now}; {named}{skips}"
