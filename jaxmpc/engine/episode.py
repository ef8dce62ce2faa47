"""An episode of one lane: what is carried from sample to sample, what is measured on the way and what is left of it.

Whoever runs episodes brings time, lanes and scalar functions. Sums are taken stretch by stretch: that keeps those of
float32 exact to 1e-6, and a stretch is what the reverse mode remembers.
"""

from math import inf
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxmpc import swing
from jaxmpc.law.gains import Gains
from jaxmpc.law.ops import Ops
from jaxmpc.loop import arm, linear
from jaxmpc.metrics import Extremes, JointTotals, Sums, add, add_joints, merge, no_extremes, no_joints, no_sums
from jaxmpc.world.contact import Contact
from jaxmpc.world.robot import HeartSample, Robot

STRETCH = 125
"""Samples of a stretch."""


class Episode(Protocol):
    """What is run; hashable."""

    def taken_apart(self, now: Any) -> Any:
        """The signals of a sample as the step takes them: tuples of scalars."""

    def begin(self, lane: Any, ops: Ops) -> Any:
        """What is carried, before the first sample."""

    def step(self, lane: Any, run: Any, now: Any, ops: Ops) -> tuple[Any, Any]:
        """One sample: what is carried on, and the sample itself."""

    def fold(self, lane: Any, run: Any, ops: Ops) -> Any:
        """What is carried on from the end of a stretch."""

    def found(self, run: Any) -> Any:
        """What is left at the end."""


class AxisLane(NamedTuple):
    """One controller on one contact."""

    gains: Gains
    """Taken apart into scalars."""
    contact: Contact
    lsb: Any
    """Quantisation of the force sensor [N]."""
    force_limit: Any
    """Largest measured force of a run that is fine [N]."""
    high_pass: swing.HighPass | None
    """What the force is judged by at the end; None where nobody asks how it swings."""


class AxisProgress(NamedTuple):
    """What an axis of the linear loop carries."""

    carry: linear.LinearCarry
    filters: swing.Sections | None
    partial: Sums
    """Over the present stretch."""
    sums: Sums
    """Over all before it."""
    extremes: Extremes
    stretches: Any
    """How many have ended."""
    diverged: Any
    over_limit: Any


class AxisFound(NamedTuple):
    """What is left of an axis."""

    sums: Sums
    extremes: Extremes
    diverged: Any
    """When the stretch began in which the force left `HIGHEST_FORCE`, ∞ if never [s]."""
    over_limit: Any
    """When that began in which force or residual left its limit, ∞ if never [s]."""


class AxisEpisode(NamedTuple):
    """The linear loop of one axis."""

    def taken_apart(self, now: linear.AxisSignals) -> linear.AxisSignals:
        """See `Episode`."""
        return now._replace(force_ref=tuple(now.force_ref))

    def begin(self, lane: AxisLane, ops: Ops) -> AxisProgress:
        """See `Episode`."""
        zero = 0.0 * lane.gains.mpc_u
        empty, filters = no_sums(zero), None if lane.high_pass is None else swing.rest(zero)
        begun, never = linear.start(lane.gains), zero + inf
        return AxisProgress(begun, filters, empty, empty, no_extremes(zero), zero, never, never)

    def step(
        self, lane: AxisLane, run: AxisProgress, now: linear.AxisSignals, ops: Ops
    ) -> tuple[AxisProgress, linear.Sample]:
        """See `Episode`."""
        before = run.carry.contact.pending[0]
        following, sample = linear.advance(lane.gains, lane.contact, lane.lsb, run.carry, now, ops)
        wanted, filters, swinging = now.present, run.filters, 0.0
        if filters is not None and lane.high_pass is not None:
            above, filters = swing.step(lane.high_pass, filters, sample.true_force)
            swinging = ops.where(now.late, above, 0.0)
        errors = sample.force - wanted, sample.true_force - wanted
        measured = *errors, sample.a, sample.a - before, sample.force, swinging
        partial, extremes = add(run.partial, run.extremes, now.score, *measured, ops)
        return run._replace(carry=following, filters=filters, partial=partial, extremes=extremes), sample

    def fold(self, lane: AxisLane, run: AxisProgress, ops: Ops) -> AxisProgress:
        """See `Episode`; a moment is told to a stretch: one per sample would cost what only a lost run needs."""
        most, began = run.extremes, STRETCH * run.stretches * lane.contact.T_s
        within = ops.where(most.highest_force < lane.force_limit, most.largest_error < linear.HIGHEST_ERROR, False)
        return run._replace(
            partial=no_sums(0.0 * lane.gains.mpc_u),
            sums=merge(run.sums, run.partial),
            stretches=run.stretches + 1.0,
            # A comparison with what is no number is false.
            diverged=ops.minimum(run.diverged, ops.where(most.highest_force < linear.HIGHEST_FORCE, inf, began)),
            over_limit=ops.minimum(run.over_limit, ops.where(within, inf, began)),
        )

    def found(self, run: AxisProgress) -> AxisFound:
        """See `Episode`."""
        return AxisFound(run.sums, run.extremes, run.diverged, run.over_limit)


class ArmLane(NamedTuple):
    """One controller on one tissue and motion."""

    cell: arm.Cell
    force_limit: Any
    """Largest measured force of a run that is fine [N]."""
    high_pass: swing.HighPass | None
    """What the force is judged by at the end; None where nobody asks how it swings."""


class ArmProgress(NamedTuple):
    """What the arm carries."""

    carry: arm.ArmCarry
    filters: tuple[swing.Sections, ...] | None
    partial: tuple[Sums, ...]
    """Per axis, over the present stretch."""
    sums: tuple[Sums, ...]
    """Over all before it."""
    extremes: tuple[Extremes, ...]
    joints: JointTotals
    trouble: arm.Trouble


class ArmFound(NamedTuple):
    """What is left of the arm."""

    sums: tuple[Sums, ...]
    """Per axis."""
    extremes: tuple[Extremes, ...]
    joints: JointTotals
    trouble: arm.Trouble


class ArmEpisode(NamedTuple):
    """The loop on the arm."""

    loop: arm.ArmLoop

    def taken_apart(self, now: arm.ArmSignals) -> arm.ArmSignals:
        """See `Episode`."""
        return now._replace(
            heart=_heart(now.heart),
            between=tuple(map(_heart, now.between)),
            noise=tuple(now.noise),
            force_ref=tuple(map(tuple, now.force_ref)),
            score=tuple(now.score),
            wanted=None if now.wanted is None else tuple(now.wanted),
        )

    def begin(self, lane: ArmLane, ops: Ops) -> ArmProgress:
        """See `Episode`."""
        zero = 0.0 * lane.cell.K2
        empty, most = (no_sums(zero),) * 3, (no_extremes(zero),) * 3
        filters = None if lane.high_pass is None else (swing.rest(zero),) * 3
        begun = arm.start(self.loop, lane.cell, ops)
        return ArmProgress(begun, filters, empty, empty, most, no_joints(zero), arm.untroubled(zero))

    def step(self, lane: ArmLane, run: ArmProgress, now: arm.ArmSignals, ops: Ops) -> tuple[ArmProgress, arm.ArmSample]:
        """See `Episode`."""
        before = run.carry
        following, sample = arm.advance(self.loop, lane.cell, before, now, ops)
        swinging, filters = _swinging(lane, run.filters, sample, now, ops)
        forces = run.partial, run.extremes, now.score, now.present, sample.force, sample.true_force
        partial, extremes = zip(
            *(
                add(sums, most, score > 0.0, force - ref, true - ref, a, a - then, force, above, ops)
                for sums, most, score, ref, force, true, a, then, above in zip(
                    *forces, sample.a, before.a, swinging, strict=True
                )
            ),
            strict=True,
        )
        x, y, z = now.score
        joints = add_joints(run.joints, x + y + z > 0.0, sample.clamped[0], sample.wanted, before.wanted, ops)
        trouble = arm.noticed(run.trouble, sample, now, lane.force_limit, ops)
        return ArmProgress(following, filters, partial, run.sums, extremes, joints, trouble), sample

    def fold(self, lane: ArmLane, run: ArmProgress, ops: Ops) -> ArmProgress:
        """See `Episode`."""
        sums = tuple(merge(*pair) for pair in zip(run.sums, run.partial, strict=True))
        return run._replace(partial=(no_sums(0.0 * lane.cell.K2),) * 3, sums=sums)

    def found(self, run: ArmProgress) -> ArmFound:
        """See `Episode`."""
        return ArmFound(run.sums, run.extremes, run.joints, run.trouble)


def _heart(values: Any) -> HeartSample:
    return HeartSample(tuple(values[0]), tuple(values[1]))


def on_tissues(robot: Robot, stiffness: Any) -> Robot:
    """The robot's constants against (motions, tissues, controllers), on tissues of a stiffness.

    Args:
        robot: Each constant one number, one per motion (motions,) or per cell (motions, tissues).
        stiffness: Broadcasts against all three dimensions [N/m].
    """

    def before_controllers(leaf: Any) -> Any:
        shape = jnp.shape(leaf)
        return jnp.reshape(leaf, (*shape, *(1,) * (3 - len(shape)))) if shape else leaf

    robot = jax.tree.map(before_controllers, robot)
    return robot._replace(tissue=robot.tissue._replace(stiffness=stiffness))


def _swinging(lane: ArmLane, filters: Any, sample: arm.ArmSample, now: arm.ArmSignals, ops: Ops) -> tuple[Any, Any]:
    """What of the true force swings at the end of the run, and the filters moved on; nothing if nobody asked."""
    constants = lane.high_pass
    if filters is None or constants is None:
        return (0.0,) * 3, None
    moved = [swing.step(constants, one, force) for one, force in zip(filters, sample.true_force, strict=True)]
    passed, states = zip(*moved, strict=True)
    return tuple(ops.where(now.late > 0.0, above, 0.0) for above in passed), states
