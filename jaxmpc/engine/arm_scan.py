"""The loop on the arm over time as a scan, over every motion, tissue and controller at once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc import swing
from jaxmpc.engine.episode import ArmEpisode, ArmLane, ArmProgress, on_tissues
from jaxmpc.engine.linear_scan import over_stretches
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmLoop, ArmSample, ArmSignals, Cell, Trouble
from jaxmpc.metrics import Metrics, metrics
from jaxmpc.world.robot import Robot
from jaxmpc.xla import ops

Transform = Callable[[Callable[..., Any], Any], Callable[..., Any]]
"""What an engine makes of the step before it is run; also given a scalar 1 that is no constant of the program."""


def over_arm_cells(
    loop: ArmLoop,
    gains: Gains,
    K2: Any,
    robot: Robot,
    stiffness: Any,
    signals: ArmSignals,
    force_limit: Any,
    traced: bool,
    transform: Transform,
) -> tuple[Metrics, Trouble, ArmSample | None]:
    """Every controller on every tissue and motion.

    Controllers are the innermost dimension of the computation, as in `linear_scan.over_cells`.

    Args:
        loop: Arm and structure.
        gains: Taken apart into scalars, each (controllers,).
        K2: Damping, (controllers,) [1/s].
        robot: Constants, each one number, one per motion (motions,) or per cell (motions, tissues); the stiffness
            is left open.
        stiffness: (tissues,) or (motions, tissues) [N/m].
        signals: With the motions as leading dimension.
        force_limit: Largest measured force of a run that is fine [N].
        traced: Keep every sample.
        transform: Applied to the step.

    Returns:
        Metrics (controllers, tissues, 3·motions), troubles (controllers, tissues, motions), and samples whose vectors
        are the second-to-last dimension: (controllers, tissues, 3 or 4, steps, …), of the first motion.
    """
    motions = signals.time.shape[0]
    shape = (motions, jnp.shape(stiffness)[-1], *jnp.shape(K2))

    def everywhere(value: Any) -> Any:
        return jnp.broadcast_to(value, shape)

    touching = on_tissues(robot, everywhere(stiffness[..., None]))
    cells = Cell(jax.tree.map(everywhere, gains), everywhere(K2), touching)
    # Every operation is elementwise, so arrays may stand for the scalars of the law; vmap traces three times longer.
    met = jax.tree.map(lambda signal: jnp.moveaxis(signal, 0, -1)[..., None, None], signals)
    found, trouble, samples = run(loop, cells, met, force_limit, traced, transform)

    def per_cell(leaf: Any) -> Any:
        return jnp.transpose(leaf, (3, 2, 1, 0)).reshape(*shape[:0:-1], 3 * motions)

    def kept(field: Any) -> Any:
        """(controllers, tissues, axes, steps, …) of the first motion."""
        axes = field if isinstance(field, tuple) else tuple(jnp.moveaxis(field, 1, 0))
        stacked = jnp.stack([jnp.broadcast_to(axis[..., 0, :, :], (*axis.shape[:-3], *shape[1:])) for axis in axes])
        return jnp.moveaxis(stacked, (-1, -2), (0, 1))

    times = jax.tree.map(jnp.transpose, trouble)
    return jax.tree.map(per_cell, found), times, None if samples is None else ArmSample(*map(kept, samples))


def run(
    loop: ArmLoop, cell: Cell, signals: ArmSignals, force_limit: Any, traced: bool, transform: Transform
) -> tuple[Metrics, Trouble, ArmSample | None]:
    """Metrics per axis, first troubles and, if wanted, every sample of one cell.

    Each sample is one checkpoint of the reverse mode, which then holds the carry of every step and no more.
    """
    judged, episode = signals.late is not None, ArmEpisode(loop)
    lane = ArmLane(cell, force_limit, swing.high_pass(cell.robot.measurement.T_s, ops) if judged else None)

    def sample_of(lane: ArmLane, state: ArmProgress, now: ArmSignals) -> tuple[ArmProgress, ArmSample]:
        return episode.step(lane, state, now, ops)

    def one(state: ArmProgress, raw: ArmSignals) -> tuple[ArmProgress, ArmSample | None]:
        opaque = 1.0 + 0.0 * raw.time.ravel()[0]
        following, sample = transform(sample_of, opaque)(lane, state, episode.taken_apart(raw))
        return following, sample._replace(force_ref=raw.force_ref) if traced else None

    def stretch(state: ArmProgress, part: ArmSignals) -> tuple[ArmProgress, ArmSample | None]:
        state, samples = jax.lax.scan(jax.checkpoint(one), state, part)
        return episode.fold(lane, state, ops), samples

    state, samples = over_stretches(stretch, episode.begin(lane, ops), signals)
    sums, extremes, joints, trouble = episode.found(state)
    count, late = jnp.sum(signals.score, axis=0), jnp.sum(signals.late, axis=0) if judged else None
    axes, steps = zip(sums, extremes, count, strict=True), len(signals.time)
    found = [metrics(added, most, counted, steps, late, joints, ops) for added, most, counted in axes]
    per_axis: Metrics = jax.tree.map(lambda *axes: jnp.stack(axes), *found)
    if not traced:
        return per_axis, trouble, None
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), samples)
    return per_axis, trouble, jax.tree.map(lambda *parts: jnp.concatenate(parts), *flat)
