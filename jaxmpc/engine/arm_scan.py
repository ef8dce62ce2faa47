"""The loop on the arm over time as a scan, over every motion, tissue and controller at once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxmpc import swing
from jaxmpc.engine.linear_scan import over_stretches
from jaxmpc.law.gains import Gains
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
from jaxmpc.metrics import (
    JointTotals,
    Metrics,
    Totals,
    add,
    add_joints,
    merge,
    merge_joints,
    metrics,
    no_joints,
    nothing,
)
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

    def sample_of(cell: Cell, state: Any, now: ArmSignals) -> tuple[Any, ArmSample]:
        carry, passing, (totals, joints), trouble = state
        following, sample = advance(loop, cell, carry, now, ops)
        swinging, passing = swinging_of(passing, sample, now)
        wanted = [ahead[0] for ahead in now.force_ref]
        forces = totals, now.score, wanted, sample.force, sample.true_force
        totals = tuple(
            add(total, score > 0.0, force - ref, true - ref, a, a - before, force, above, ops)
            for total, score, ref, force, true, a, before, above in zip(
                *forces, sample.a, carry.a, swinging, strict=True
            )
        )
        x, y, z = now.score
        counts = x + y + z > 0.0
        joints = add_joints(joints, counts, sample.clamped[0], sample.wanted, carry.wanted, ops)
        trouble = noticed(trouble, sample, now, force_limit, ops)
        return (following, passing, (totals, joints), trouble), sample

    def swinging_of(passing: Any, sample: ArmSample, now: ArmSignals) -> tuple[Any, Any]:
        """What of the true force swings at the end of the run, and the filters moved on; nothing if nobody asked."""
        if passing is None:
            return (0.0,) * 3, None
        moved = [swing.step(filtering, one, force) for one, force in zip(passing, sample.true_force, strict=True)]
        passed, states = zip(*moved, strict=True)
        return tuple(ops.where(now.late > 0.0, above, 0.0) for above in passed), states

    def one(state: Any, raw: ArmSignals) -> tuple[Any, ArmSample | None]:
        opaque = 1.0 + 0.0 * raw.time.ravel()[0]
        following, sample = transform(sample_of, opaque)(cell, state, at_one_sample(raw))
        return following, sample._replace(force_ref=raw.force_ref) if traced else None

    def stretch(state: Any, part: ArmSignals) -> tuple[Any, ArmSample | None]:
        carry, passing, (totals, joints), trouble = state
        begin = carry, passing, empty, trouble
        (carry, passing, partial, trouble), samples = jax.lax.scan(jax.checkpoint(one), begin, part)
        totals = tuple(merge(*pair, ops) for pair in zip(totals, partial[0], strict=True))
        return (carry, passing, (totals, merge_joints(joints, partial[1], ops)), trouble), samples

    zero, judged = 0.0 * cell.K2, signals.late is not None
    filtering = swing.high_pass(cell.robot.measurement.T_s, ops)
    empty: tuple[tuple[Totals, ...], JointTotals] = (nothing(zero),) * 3, no_joints(zero)
    resting = (swing.rest(zero),) * 3 if judged else None
    begin: tuple[ArmCarry, Any, Any, Trouble] = start(loop, cell, ops), resting, empty, untroubled(zero)
    (_, _, (totals, joints), trouble), samples = over_stretches(stretch, begin, signals)
    count, late = jnp.sum(signals.score, axis=0), jnp.sum(signals.late, axis=0) if judged else None
    found = [metrics(total, count[i], len(signals.time), late, joints, ops) for i, total in enumerate(totals)]
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
