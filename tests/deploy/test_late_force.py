"""A force that comes late is told by the lag of the sine's answer, on all axes and for long enough."""

import math

import numpy as np
import pytest

from deploy.runtime import force_lag
from deploy.runtime.force_lag import HEARD
from deploy.safety.late_force import LATE, late_step
from deploy.safety.reasons import Reason
from jaxmpc.law.identification import step
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.stiffness import SILENT, unknown
from tests.deploy.made import T_S, scheduled_gains

CONSTANTS = scheduled_gains().schedule.identification
SAMPLES = 20
"""In a row at 1 kHz."""
OMEGA = math.atan2(CONSTANTS.turn[1], CONSTANTS.turn[0]) / T_S


def heard(late: float, stiffness: float = 900.0, damping: float = 0.0, seconds: float = 3.0):
    """An identification that has listened to a tip which the sine moves, and to a force so late [s]."""
    state = unknown(CONSTANTS, 0.0)
    for t in T_S * np.arange(round(seconds / T_S)):
        tip = 1e-4 * math.sin(OMEGA * t)
        force = 1e-4 * (stiffness * math.sin(OMEGA * (t - late)) + damping * OMEGA * math.cos(OMEGA * (t - late)))
        state = step(CONSTANTS, state, force, tip, 0.0, 0.0, SILENT, FLOATS)
        state = state._replace(listening=1.0)
    return state


def lag(state):
    return force_lag.lag(CONSTANTS, state.listening, state.heard, *state.force[-1], *state.tip[-1])


@pytest.mark.parametrize("late", [0.0, 1e-3, 5e-3, 20e-3])
@pytest.mark.parametrize("stiffness", [300.0, 2200.0])
def test_the_lag_is_that_of_the_force_whatever_the_stiffness(late, stiffness):
    # A low-pass of 0.05 a sample passes 0.23 of the double frequency, three of them 0.013, in Y and in X: 0.026 rad.
    assert lag(heard(late, stiffness)) == pytest.approx(late, abs=0.026 / OMEGA)


def test_damping_leads():
    assert lag(heard(0.0, damping=2.0)) < 0.0


@pytest.mark.parametrize("changes", [{"listening": 0.4}, {"heard": HEARD - 0.01}])
def test_nothing_is_told_before_it_was_heard(changes):
    assert lag(heard(5e-3)._replace(**changes)) == 0.0


def run(lags):
    count, found = 0, []
    for each in lags:
        count, reason = late_step(count, each, 1e-3)
        found.append(reason)
    return found


def test_late_on_every_axis_and_for_long_enough():
    over, under = (1.01 * LATE,) * 3, (1.01 * LATE, 1.01 * LATE, 0.99 * LATE)
    assert run([under] * 100) == [None] * 100
    assert run([over] * (SAMPLES - 1) + [under] + [over] * SAMPLES) == [None] * (2 * SAMPLES - 1) + [Reason.FORCE_MODEL]


def test_where_no_sine_tells_it_nothing_is_late():
    assert run([(0.0, 0.0, 0.0)] * 100) == [None] * 100
