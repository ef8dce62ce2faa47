"""Pucks of the twin cut at their MT: what the controller is told that acted has acted, or nothing moves."""

import itertools

import pytest

from deploy.bus.bus import Bus
from deploy.errors import CalibrationError
from deploy.loop.cycle import OperatorCommand
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.reference.sources import ConstantForce
from deploy.twin.flight import Pilot
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.pucks import Puck
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact

HARD = 200.0
"""Joint torque that is asked for either way in turn, more than any motor gives [N m]."""


@pytest.fixture
def started():
    """A session with a twin whose pucks have such MT, and what it said."""
    buses = []

    def start(max_torque):
        twin = Twin(TwinSettings(gap=0.003, motion=motion_named("none"), max_torque=max_torque))
        clock, said = LockstepClock(twin), []
        buses.append(Bus(LockstepBus(clock), clock.now))
        options = Options(ConstantForce((0.0, 0.0, -1.0)), turns=False, tare=False)
        return Session(arm_artifact(), buses[-1], clock, options, said.append), twin, said

    yield start
    for bus in buses:
        bus.close()


def test_what_the_observers_are_told_is_what_the_motors_give(started, monkeypatch):
    session, twin, said = started((4860.0, 4500.0, 4500.0, 4320.0))
    assert said[-1] == (
        "torque is limited as the pucks' MT says: motor 2 at 1.67 instead of 1.78 N m, motor 3 at 1.67 instead of "
        "1.78 N m"
    )
    commands, command = [], Puck.command

    def taken(puck, units):
        command(puck, units)
        if puck.driving:
            commands.append((units, round(puck.torque * 2700.0)))

    monkeypatch.setattr(Puck, "command", taken)
    signs = (sign for sign in itertools.cycle((1.0, -1.0)) for _ in range(40))
    monkeypatch.setattr(session.controller, "torque", lambda *asked: (next(signs) * HARD,) * 4)
    session.run(OperatorCommand(True, True), None, Pilot(session, twin, 0.1))
    assert max(abs(sent) for sent, _ in commands) > 4400
    assert all(sent == given for sent, given in commands)


@pytest.mark.parametrize("motor", range(4))
def test_pucks_that_give_far_less_are_refused(started, motor):
    caps = [4860.0, 4860.0, 4860.0, 4320.0]
    caps[motor] = 1800.0
    with pytest.raises(CalibrationError, match=f"motor {motor + 1} cuts its torque at 0.667 N m"):
        started(tuple(caps))
