"""The last samples of the golden trace once more, at every knot of a schedule, with its gains in control.

A run visits a tissue or two, and the gains of knots far from these answer to nothing in it: they could be any. So each
knot answers by itself. Contact begins anew at the first of these samples, and before each of them the tissue of every
axis is taken for known, with the stiffness of the knot.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from deploy.runtime.arm import ArmRuntime
from jaxmpc.law import entry, force_control
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.force_control import Controller
from jaxmpc.law.gains import GainSchedule
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.reference import split, told

SAMPLES = 16
"""How many at most: a few suffice, since each gain acts from the second or third on."""
Sample = tuple[Any, Any, Any]
"""Joint angles [rad], measured and wanted force [N], as the runtime of an arm takes them."""


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


def torques(controller: Controller, compensated: bool, trace: Sequence[Sample], preview: bool) -> np.ndarray:
    """Joint torques that the law wants at each knot, nothing recorded, (knots, up to `SAMPLES`, 4) [N m].

    Args:
        controller: Floats; with a schedule, without preview with one weight of the reference.
        compensated: Whether friction is cancelled.
        trace: The golden trace.
        preview: Whether the wanted force is known ahead.
    """
    found: list[list[Any]] = []
    for knot in _schedule(controller).knots:
        q, force, _ = trace[-SAMPLES:][0]
        at_rest = force_control.init(controller, tuple(q), tuple(force), compensated)
        state = entry.enter(controller, at_rest, tuple(force), (0.0, 0.0, 0.0), FLOATS)
        found.append([])
        for q, force, wanted in trace[-SAMPLES:]:
            x, y, z = (_knowing(axis, knot.log_stiffness) for axis in state.axes)
            ahead = wanted if preview else [(axis,) for axis in wanted]
            present, ahead = split(ahead, len(controller.gains.mpc_ref))
            before = state._replace(axes=(x, y, z))
            state, command = force_control.step(
                controller, before, tuple(q), tuple(force), ahead, FLOATS, present=present
            )
            state = force_control.applied(state, command, command.torque.torque)
            found[-1].append(command.torque.torque)
    return np.array(found)


def replayed(runtime: ArmRuntime, schedule: GainSchedule, trace: Sequence[Sample]) -> np.ndarray:
    """The same from the runtime that flies, whatever it has run before."""
    found: list[list[Any]] = []
    for knot in schedule.knots:
        q, force, _ = trace[-SAMPLES:][0]
        runtime.start(tuple(q))
        runtime.enter(tuple(force), tuple(q))
        found.append([])
        for q, force, wanted in trace[-SAMPLES:]:
            runtime.believe(knot.log_stiffness)
            found[-1].append(runtime.control(q, runtime.velocity(q), force, wanted))
    return np.array(found)


def _knowing(axis: AxisState, log_stiffness: float) -> AxisState:
    assert axis.tissue is not None
    return axis._replace(tissue=axis.tissue._replace(log_stiffness=log_stiffness, authority=1.0))


def _schedule(controller: Controller) -> GainSchedule:
    schedule: GainSchedule | None = controller.gains.schedule
    assert schedule is not None
    return schedule
