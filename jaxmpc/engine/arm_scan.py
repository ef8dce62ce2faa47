"""The loop on the arm over time as a scan, over every motion, tissue and controller at once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxmpc.engine.linear_scan import over_stretches
from jaxmpc.law.cascade import Gains
from jaxmpc.loop.arm import (
    ArmCarry,
    ArmLoop,
    ArmSample,
    ArmSignals,
    Cell,
    Trouble,
    advance,
    noticed,
    start,
    untroubled,
)
from jaxmpc.metrics import Metrics, Totals, add, merge, metrics, nothing
from jaxmpc.world.robot import HeartSample, Robot
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

    def over_controllers(leaf: Any) -> Any:
        return jnp.reshape(leaf, (*jnp.shape(leaf), *(1,) * (3 - jnp.ndim(leaf)))) if jnp.ndim(leaf) else leaf

    robot = jax.tree.map(over_controllers, robot)
    on_tissues = robot._replace(tissue=robot.tissue._replace(stiffness=everywhere(stiffness[..., None])))
    cells = Cell(jax.tree.map(everywhere, gains), everywhere(K2), on_tissues)
    # Every operation is elementwise, so arrays may stand for the scalars of the law; vmap traces three times longer.
    met = ArmSignals(*(jnp.moveaxis(signal, 0, -1)[..., None, None] for signal in signals))
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

    def sample_of(cell: Cell, state: Any, now: ArmSignals) -> tuple[Any, ArmSample]:
        carry, (totals, clamped), trouble = state
        following, sample = advance(loop, cell, carry, now, ops)
        totals = tuple(
            add(total, score > 0.0, force - wanted[0], a, a - before, force, ops)
            for total, score, force, wanted, a, before in zip(
                totals, now.score, sample.force, now.force_ref, sample.a, carry.a, strict=True
            )
        )
        trouble = noticed(trouble, sample, now, force_limit, ops)
        return (following, (totals, clamped + sample.clamped[0]), trouble), sample

    def one(state: Any, raw: ArmSignals) -> tuple[Any, ArmSample | None]:
        opaque = 1.0 + 0.0 * raw.time.ravel()[0]
        following, sample = transform(sample_of, opaque)(cell, state, at_one_sample(raw))
        return following, sample._replace(force_ref=raw.force_ref) if traced else None

    def stretch(state: Any, part: ArmSignals) -> tuple[Any, ArmSample | None]:
        carry, (totals, clamped), trouble = state
        (carry, partial, trouble), samples = jax.lax.scan(jax.checkpoint(one), (carry, empty, trouble), part)
        totals = tuple(merge(*pair, ops) for pair in zip(totals, partial[0], strict=True))
        return (carry, (totals, clamped + partial[1]), trouble), samples

    zero = 0.0 * cell.K2
    empty: tuple[tuple[Totals, ...], Any] = (nothing(zero),) * 3, zero
    begin: tuple[ArmCarry, Any, Trouble] = start(loop, cell, ops), empty, untroubled(zero)
    (_, (totals, clamped), trouble), samples = over_stretches(stretch, begin, signals)
    count, share = jnp.sum(signals.score, axis=0), clamped / len(signals.time)
    found = [metrics(total, count[i], share, ops) for i, total in enumerate(totals)]
    per_axis: Metrics = jax.tree.map(lambda *axes: jnp.stack(axes), *found)
    if not traced:
        return per_axis, trouble, None
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), samples)
    return per_axis, trouble, jax.tree.map(lambda *parts: jnp.concatenate(parts), *flat)


def at_one_sample(now: ArmSignals) -> ArmSignals:
    """The signals of a sample as the step takes them: tuples of scalars."""
    return now._replace(
        heart=_heart(now.heart),
        between=tuple(map(_heart, now.between)),
        noise=tuple(now.noise),
        force_ref=tuple(map(tuple, now.force_ref)),
        score=tuple(now.score),
    )


def _heart(values: Array) -> HeartSample:
    return HeartSample(tuple(values[0]), tuple(values[1]))
