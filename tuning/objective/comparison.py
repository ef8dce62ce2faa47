"""Controllers side by side on scenarios that no tuner saw."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.closed_loops import close_loops, lasted_per_motion, per_motion, run_loops
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.engine.registry import fastest, named
from jaxmpc.engine.scenario import program_spec
from jaxmpc.experiment import Experiment
from jaxmpc.metrics import Metrics
from jaxmpc.synthesis.params import Params, by_structure
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.blocks import padded
from jaxmpc.xla.once import JitOnce
from tuning.job.goals import OVERSHOOT, run_goals
from tuning.job.scenarios import scene_over
from tuning.job.spec import TuneSpec

BLOCK, KERNEL_BLOCK = 12, 48
"""Scenarios that run at a time, in the kernel in the time of one: one program serves any number of them."""


class Room(NamedTuple):
    """What a program of the kernel is compiled for at least: copies fill it up, which takes it no longer to run."""

    controllers: int = 1
    """Their structure is one."""
    scenarios: int = 1
    """Their experiment is one."""


NO_MORE = Room()
"""What is asked for, and nothing besides."""


def compare(
    controllers: Sequence[Params],
    experiments: Sequence[Experiment],
    show: bool = False,
    engine: str | None = None,
    room: Room = NO_MORE,
) -> Metrics:
    """What is measured of several controllers in each scenario.

    Args:
        controllers: The controllers; those of one structure run side by side.
        experiments: Scenarios of one experiment.
        show: Whether to show progress.
        engine: What runs them; None is the fastest here.
        room: The least that programs of the kernel are compiled for.

    Returns:
        Each field (controllers, scenarios, stiffness, 3); NaN where a run left the finite numbers or 1 kN.
    """
    alike = by_structure(controllers)
    parts = [_compare([controllers[i] for i in rows], experiments, show, engine, room) for rows in alike]
    order = np.argsort(np.concatenate(alike))
    whole: Metrics = jax.tree.map(lambda *fields: np.concatenate(fields)[order], *parts)
    return whole


def versus(
    spec: TuneSpec, candidates: Sequence[Params], met: Sequence[Experiment], show: bool = False
) -> tuple[Metrics, list[Metrics]]:
    """A job's controller before tuning, and others, in the same scenarios.

    Returns:
        Of the one before and of each candidate, every field (scenarios, stiffness, 3).
    """
    parts = [compare(*pair, show, spec.engine, room_of(spec)) for pair in pairs_of(spec, candidates, met)]
    runs = jax.tree.map(lambda *fields: np.concatenate(fields), *parts)
    before, *each = (jax.tree.map(lambda field, i=i: field[i], runs) for i in range(1 + len(candidates)))
    return before, each


def pairs_of(
    spec: TuneSpec, candidates: Sequence[Params], met: Sequence[Experiment]
) -> list[tuple[Sequence[Params], Sequence[Experiment]]]:
    """A job's controller before tuning and others, each with what they meet; together where that is the same."""
    if spec.met_before(met) == list(met):
        return [([spec.before, *candidates], met)]
    return [([spec.before], spec.met_before(met)), (candidates, met)]


def standing_of(spec: TuneSpec, after: Metrics, before: Metrics) -> float:
    """The job's risk over the scenarios, each with its largest soft goal of the runs [-]; ∞ where a run was lost.

    Args:
        spec: The job.
        after: Of the controller to judge, each field (scenarios, stiffness, 3).
        before: Of the controller before tuning, the same.
    """
    largest = _largest(
        {name: spec.soft[name] for name in spec.soft if name != OVERSHOOT} or {"rms": 1.0}, after, before
    )
    if np.isnan(largest).any():
        return np.inf
    if spec.params.listening is None:
        return float(spec.risk.over(largest.max(axis=0)))
    # A knot serves its own tissue, so each counts, as in the search.
    return float(np.exp(np.mean(np.log(np.asarray(spec.risk.over(largest))))))


def missed_by(spec: TuneSpec, after: Metrics, before: Metrics) -> float:
    """The largest hard goal of the runs, at most 1 where all are held [-]; ∞ where a run was lost. Rest as above.

    The overshoot is the linear loop's: no scenario has another.
    """
    asked = {name: limit for name, limit in spec.hard_goals.items() if name != OVERSHOOT}
    return float(np.nan_to_num(_largest(asked, after, before).max(), nan=np.inf)) if asked else 0.0


def _largest(asked: Mapping[str, float], after: Metrics, before: Metrics) -> np.ndarray:
    """The largest of some goals, normalised, (stiffness, scenarios) [-]; NaN where a run was lost."""
    swapped, reference = jax.tree.map(lambda field: np.swapaxes(field, 0, 1), (after, before))
    goals = run_goals(swapped, reference, None, asked)
    largest: np.ndarray = np.max([np.asarray(goal).max(axis=2) for goal in goals.values()], axis=0)
    return largest


def room_of(spec: TuneSpec) -> Room:
    """As much as a job's proof needs at most, so that validation and what is held out share their programs."""
    seeds = max(len(spec.tune.validation_seeds), len(spec.tune.heldout_seeds))
    return Room(1 + spec.tune.starts, min(seeds, KERNEL_BLOCK))


def compile_ahead(spec: TuneSpec, controllers: Sequence[Params], experiments: Sequence[Experiment]) -> None:
    """Compile what `versus` runs of such controllers in such scenarios."""
    for rows in by_structure(controllers):
        world, batch, blocks = _filled([controllers[i] for i in rows], experiments, spec.engine, room_of(spec))
        _run.compile(batch, scene_over(blocks[0]), world)


def _compare(
    controllers: Sequence[Params], experiments: Sequence[Experiment], show: bool, engine: str | None, room: Room
) -> Metrics:
    """`compare` of controllers of one structure."""
    world, batch, blocks = _filled(controllers, experiments, engine, room)
    count, parts = len(experiments), []
    with progress("compare", count, "scenarios", show) as tick:
        for met in blocks:
            parts.append(jax.tree.map(np.asarray, _run(batch, scene_over(met), world)))
            tick(min(len(met) * len(parts), count), "")
    found: Metrics = jax.tree.map(lambda *fields: np.concatenate(fields, 1)[: len(controllers), :count], *parts)
    return found


def _filled(
    controllers: Sequence[Params], experiments: Sequence[Experiment], engine: str | None, room: Room
) -> tuple[ProgramSpec, Params, list[list[Experiment]]]:
    """The world, controllers side by side, and scenarios that run together; the last of either fills up."""
    world, count = named(fastest(program_spec(experiments[0])), engine), len(experiments)
    if world.engine == "kernel":
        least, size = room.controllers, min(KERNEL_BLOCK, max(room.scenarios, count))
    else:
        least, size = 1, min(BLOCK, count)
    batch = padded(Params.stack(controllers), least)
    blocks = [[experiments[min(first + i, count - 1)] for i in range(size)] for first in range(0, count, size)]
    return world, batch, blocks


@partial(JitOnce, static_argnames=("world",))
def _run(batch: Params, scene: ScenarioData, world: ProgramSpec) -> Metrics:
    run = run_loops(close_loops(batch, scene.stiffness, scene.path), scene, world=world, dtype="float64")
    lasted = lasted_per_motion(run)[..., None]

    def scenarios_first(field: Any) -> Any:
        """With dimensions (controllers, scenarios, stiffness, 3), NaN where the run did not last."""
        return jnp.moveaxis(jnp.where(lasted, per_motion(field), jnp.nan), 2, 1)

    found: Metrics = jax.tree.map(scenarios_first, run.metrics)
    return found
