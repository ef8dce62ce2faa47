"""How long a controller remembers what was before a recording began: so long a replay of it is not judged."""

import math
from collections.abc import Iterator

import numpy as np

from deploy.controller.artifact import Artifact
from deploy.runtime.straightline import map_leaves
from jaxmpc.law import cascade
from jaxmpc.law.gains import constant_reference

SETTLING = 2.0
"""Left out at the beginning of a recording that begins (almost) in contact, at least [s]: the observers' earlier
samples are not in it. Half of that brings the paper's text controller within 1e-12."""
FILTER = 0.3
"""Left out after a missing position or cycle, at least, in which the velocity's low-pass forgets [s]."""
FORGOTTEN = 25.0
"""Time constants after which 1e-11 is left of a velocity's difference [-]."""
ALL_FORGOTTEN = 35.0
"""The same of observers, whose rates and differences may begin wrong by thousands: 1e-15 is left [-]."""


def velocity_forgets(artifact: Artifact) -> float:
    """Time after which the velocity's low-pass has forgotten a wrong velocity [s]."""
    cutoff = artifact.loop.velocity_cutoff
    return max(FILTER, FORGOTTEN / cutoff) if cutoff else FILTER


def observers_forget(artifact: Artifact) -> float:
    """Time after which observers, force filter and MPC have forgotten a wrong beginning [s]; infinite if they never do.

    Force, wanted force and the command that was applied are given, so what is wrong of an axis decays by the largest
    eigenvalue of its own step. With less gain it decays more slowly: the time counts as much as the gain that is left.
    """
    gains = constant_reference(artifact.gains)._replace(guard=None, schedule=None)
    rest = cascade.init(gains, 0.0)
    columns = []
    for vector in np.eye(len(_numbers(rest))).tolist():
        state = _filled(rest, iter(vector))
        # Without gain (MPC alone) the active state stays at its start, zero.
        state = state if gains.K[3] else state._replace(p_hat=0.0)
        following, _ = cascade.step(gains, state, 0.0, (0.0,))
        columns.append(_numbers(following._replace(v=0.0)))
    slowest = float(np.max(np.abs(np.linalg.eigvals(np.array(columns).T))))
    times = [SETTLING]
    if slowest > 0.0:
        times.append(-ALL_FORGOTTEN * artifact.T_s / math.log(slowest) if slowest < 1.0 else math.inf)
    if artifact.arm is not None and artifact.arm.momentum_observer:
        times.append(ALL_FORGOTTEN / artifact.arm.momentum_observer)
    return max(times)


def guard_forgets(artifact: Artifact) -> float:
    """Time after which a guard's share of a lasting swing has forgotten a wrong beginning [s]; 0 without a guard."""
    guard = artifact.gains.guard
    return 0.0 if guard is None else FORGOTTEN * artifact.T_s / guard.patience


def _filled(state: cascade.AxisState, numbers: Iterator[float]) -> cascade.AxisState:
    """The same with other numbers."""
    found: cascade.AxisState = map_leaves(lambda _: next(numbers), state)
    return found


def _numbers(state: cascade.AxisState) -> list[float]:
    """All that an axis remembers."""
    found: list[float] = []
    map_leaves(found.append, state)
    return found
