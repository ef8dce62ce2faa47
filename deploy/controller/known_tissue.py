"""The last samples of the golden trace once more, with a stiffness taken for known: each knot's, and beyond all bounds.

A run visits a tissue or two, and the gains of knots far from these answer to nothing in it: they could be any. So each
knot answers by itself. Contact begins anew at the first of these samples, and before each of them the tissue of every
axis is taken for known, with the stiffness of the knot.

Nor does a run come to the bounds of what may be believed, of tissue and heart. So the law is twice made to believe what
lies beyond, and comes back to its bounds. What listens, watches and learns answers late or never: with the sine on and
a heart that is plainly there, it shows in what is remembered after the last sample.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from deploy.runtime.arm import ArmRuntime
from deploy.runtime.arm_law import Memory, memory_of
from deploy.runtime.flat import flat
from jaxmpc.law import entry, force_control
from jaxmpc.law.force_control import Controller
from jaxmpc.law.gains import GainSchedule
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.reference import split, told

SAMPLES = 16
"""How many at most: a few suffice, since each gain acts from the second or third on."""
PLAIN = 1e-4
"""Displacement of a heart that is plainly there, |x| of `jaxmpc.law.pulse` [m]."""
Sample = tuple[Any, Any, Any]
"""Joint angles [rad], measured and wanted force [N], as the runtime of an arm takes them."""


class Belief(NamedTuple):
    """What is taken for known before each sample."""

    log_stiffness: float
    """ln K̂, K̂ in N/m."""
    rate: float | None = None
    """The heart's [rad/s]; None leaves what is believed of it."""


def beliefs(schedule: GainSchedule) -> list[Belief]:
    """At each knot, below the bounds and above them."""
    known = [Belief(knot.log_stiffness) for knot in schedule.knots]
    tissue, heart = schedule.identification, None if schedule.repetition is None else schedule.repetition.finder
    below = Belief(tissue.least - 1.0, None if heart is None else 0.9 * heart.least)
    above = Belief(tissue.most + 1.0, None if heart is None else 1.1 * heart.most)
    return [*known, below, above]


def samples(q: np.ndarray, force: np.ndarray, force_ref: np.ndarray, preview: bool) -> list[Sample]:
    """Those of a trace.

    Args:
        q: Measured joint angles (n, 4) [rad].
        force: Measured force (n, 3) [N].
        force_ref: Wanted force (n, 3), with preview (n, 3, H) [N].
        preview: Whether that is known ahead.
    """
    wanted = told(force_ref.tolist()) if preview else force_ref.tolist()
    return list(zip(q.tolist(), force.tolist(), wanted, strict=True))


def answers(controller: Controller, compensated: bool, trace: Sequence[Sample], preview: bool) -> dict[str, np.ndarray]:
    """What the law answers with each belief, nothing recorded: `golden_known` and `golden_memory` of `ArmModel`.

    Args:
        controller: Floats; with a schedule, without preview with one weight of the reference.
        compensated: Whether friction is cancelled.
        trace: The golden trace.
        preview: Whether the wanted force is known ahead.
    """
    torques: list[list[Any]] = []
    memory = []
    for belief in beliefs(_schedule(controller)):
        q, force, _ = trace[-SAMPLES:][0]
        at_rest = force_control.init(controller, tuple(q), tuple(force), compensated)
        state = entry.enter(controller, at_rest, tuple(force), (0.0, 0.0, 0.0), FLOATS)
        torques.append([])
        for q, force, wanted in trace[-SAMPLES:]:
            ahead = wanted if preview else [(axis,) for axis in wanted]
            present, ahead = split(ahead, len(controller.gains.mpc_ref))
            state = state._replace(**_believing(memory_of(state), belief)._asdict())
            state, command = force_control.step(
                controller, state, tuple(q), tuple(force), ahead, FLOATS, present=present
            )
            torques[-1].append(command.torque.torque)
            state = force_control.applied(state, command, command.torque.torque)
        memory.append(flat(memory_of(state)))
    return {"golden_known": np.array(torques), "golden_memory": np.array(memory)}


def replayed(runtime: ArmRuntime, schedule: GainSchedule, trace: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Both from the runtime that flies, whatever it has run before."""
    torques: list[list[Any]] = []
    memory = []
    for belief in beliefs(schedule):
        q, force, _ = trace[-SAMPLES:][0]
        runtime.start(tuple(q))
        runtime.enter(tuple(force), tuple(q))
        torques.append([])
        # What nothing is believed of stays a place, a whole number.
        believing = flat(_believing(runtime.places, belief))
        for q, force, wanted in trace[-SAMPLES:]:
            before = runtime.remembered
            runtime.remembered = tuple(before[x] if isinstance(x, int) else x for x in believing)
            torques[-1].append(runtime.control(q, runtime.velocity(q), force, wanted))
        memory.append(runtime.remembered)
    return np.array(torques), np.array(memory)


def _believing(memory: Memory, belief: Belief) -> Memory:
    """What is remembered, but with the belief, the sine on and a heart that is plainly there."""
    knowing = {"log_stiffness": belief.log_stiffness, "authority": 1.0, "listening": 1.0}
    axes = tuple(axis._replace(tissue=axis.tissue._replace(**knowing)) for axis in memory.axes)
    heart = memory.pulse
    if heart is not None:
        rate = heart.rate if belief.rate is None else belief.rate
        heart = heart._replace(rate=rate, turning=(0.0, PLAIN))
    return memory._replace(axes=axes, pulse=heart)


def _schedule(controller: Controller) -> GainSchedule:
    schedule: GainSchedule | None = controller.gains.schedule
    assert schedule is not None
    return schedule
