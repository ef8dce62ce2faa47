"""What is believed of the encoders, cycle by cycle: since when the tip withdraws, gaps."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.loop.positions import Positions
from deploy.safety.machine import OperatingState, SafetyState, Task
from deploy.safety.reasons import Reason
from jaxmpc.law.transmission import JOINT_TO_MOTOR

T_S = 1e-3
COUNTS = (100, 200, 300, 400)
READING = SimpleNamespace(counts=COUNTS, position_age=(0,) * 4)
PUSHED = tuple(2.0 * each for each in JOINT_TO_MOTOR[3])
"""Joint torques of the fourth motor, far beyond friction [N m]."""


@pytest.fixture
def positions():
    infos = (SimpleNamespace(counts_per_turn=4096),) * 4
    pucks = SimpleNamespace(infos=infos, angles=lambda counts: (0.0, 0.7, 0.0, 2.2))
    return Positions(SimpleNamespace(pucks=pucks, counts=COUNTS), T_S, lambda q: q)


def found(positions, states, read=None, reason=Reason.FINISHED, task=Task.RETRACT):
    """Cycles until the fourth encoder, which stands still, is not believed; −1 if it is to the end."""
    watch = SimpleNamespace(disturbance=PUSHED, read=read)
    for k, state in enumerate(states):
        said, _, motor = positions.take(READING, 0)
        if said is Reason.ENCODER_STUCK:
            assert motor == 3
            return k
        now = state if isinstance(state, SafetyState) else SafetyState(state, reason)
        positions.weigh(now, task, watch, None if read is None else (0.0, 0.0, 0.0))
    return -1


RETRACTING = [OperatingState.RETRACT] * 600


def test_without_a_force_it_waits_from_the_beginning_of_the_way_out(positions):
    contact = [OperatingState.CONTACT] * 500
    assert found(positions, contact, task=Task.CONTROL) == -1
    assert found(positions, RETRACTING) == 301


def test_another_reason_on_the_way_out_begins_nothing_anew(positions):
    """As the force limit, met while the tip withdraws."""
    first, second = (SafetyState(OperatingState.RETRACT, why) for why in (Reason.FINISHED, Reason.FORCE))
    states = [first] * 250 + [second._replace(cycles=k) for k in range(400)]
    assert found(positions, states) == 301


def test_what_was_found_to_lie_explains_nothing(positions):
    whole = tuple(-each for each in PUSHED)
    assert found(positions, RETRACTING, whole) == -1
    assert found(positions, RETRACTING, whole, Reason.FORCE_MODEL) > 0


def test_an_arm_that_is_armed_may_be_leant_on(positions):
    assert found(positions, [OperatingState.ARMED] * 600, (0.0,) * 4, Reason.NONE, Task.HOLD) == -1
    assert found(positions, [OperatingState.STOPPED] * 600, (0.0,) * 4, Reason.FINISHED, Task.HOLD) > 0


@pytest.mark.parametrize("gap", [2, 3, 7])
def test_an_even_motion_has_its_speed_after_a_gap_however_long(gap):
    """Positions that are too old to control are left out; their cycles are none of a motor's leaps."""
    heard = []
    infos = (SimpleNamespace(counts_per_turn=4096),) * 4
    pucks = SimpleNamespace(infos=infos, angles=lambda counts: tuple(1e-4 * each for each in counts))
    positions = Positions(SimpleNamespace(pucks=pucks, counts=(0,) * 4), T_S, heard.append)
    for k in range(1, 100):
        counts = (None if 50 <= k < 50 + gap else 5 * k, 3 * k, 0, 0)
        _, age, _ = positions.take(SimpleNamespace(counts=counts, position_age=(0,) * 4), 0)
        if age <= 2:
            heard.append(positions.q)
    steps = np.diff(np.array(heard), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to((5e-4, 3e-4, 0.0, 0.0), steps.shape), atol=1e-9)
    assert len(heard) == 99
