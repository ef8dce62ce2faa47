"""What is believed of the encoders, cycle by cycle: since when the tip withdraws."""

from types import SimpleNamespace

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
