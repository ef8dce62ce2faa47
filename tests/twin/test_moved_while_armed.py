"""An arm that is moved before it is driven: held where it is let go, not driven where its controller does not hold."""

import math

import pytest

from deploy.bus.bus import Bus
from deploy.errors import BusError, CalibrationError
from deploy.loop.cycle import OperatorCommand
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.puck.frame import Frame
from deploy.reference.segments import from_words
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from deploy.twin.world import _raised

pytestmark = pytest.mark.once

GAP = 0.02
MOVED, ACTIVATED, ENDED = 20, 2500, 3500
"""Cycles at which it is moved, within a second, activated, and let go."""


def _begun(artifact, each_tick=lambda now: None):
    """A twin over a heart that stands, the session of a started arm, and its bus."""
    twin = Twin(TwinSettings(gap=GAP, motion=motion_named("none")))
    clock = LockstepClock(twin, each_tick)
    bus = Bus(LockstepBus(clock), clock.now)
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False)
    return twin, Session(artifact, bus, clock, options, lambda sentence: None), bus


def _turned(twin, angle):
    """The posture of work, turned about the base [rad]."""
    base, *others = twin.world.posture
    return (base + angle, *others)


@pytest.mark.parametrize("lift", [0.0, 0.001, 0.06, -0.015])
def test_activation_holds_the_arm_where_it_is(plain, lift):
    seen = []
    twin, session, bus = _begun(plain, lambda now: seen.append(now.truth()))
    cycles, since = 0, 0

    def each(result):
        nonlocal cycles, since
        cycles += 1
        if cycles == MOVED:
            twin.carry(_raised(twin.settings.posture, GAP + lift), 1.0)
        if cycles == ACTIVATED:
            assert result.safety_state.state is OperatingState.ARMED
            since = len(seen)
            twin.press("activate")
        return OperatorCommand(True, False, Reason.FINISHED if cycles > ENDED else Reason.NONE, cycles > ENDED + 20)

    session.run(OperatorCommand(True, False), None, each)
    bus.close()
    held = seen[since : since + ENDED - ACTIVATED]
    # 2 mm and 0.05 m/s are gravity's error, which the servo's integral has yet to take up.
    assert max(math.dist(each.tip, held[0].tip) for each in held) < 0.005
    assert max(math.hypot(*each.tip_velocity) for each in held) < 0.1


@pytest.mark.parametrize(("fault", "ends"), [("", Reason.LATE), ("J2:lost=3@1.2", Reason.POSITION_OLD)])
@pytest.mark.parametrize("activated", [850, 1500])
def test_an_armed_arm_that_stops_does_not_move_up(plain, fault, ends, activated):
    """Three late cycles or lost positions, while it is driven or before; activated within the second that it holds."""
    seen, cycles = [], 0
    settings = TwinSettings(gap=GAP, motion=motion_named("none"), faults=(fault,) if fault else ())
    twin = Twin(settings)
    clock = LockstepClock(twin, lambda now: seen.append(now.truth()))
    bus = Bus(LockstepBus(clock), clock.now)
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False)
    session = Session(plain, bus, clock, options, lambda sentence: None)

    def each(result):
        nonlocal cycles
        cycles += 1
        if cycles == activated:
            twin.press("activate")
        if not fault and cycles in (1200, 1220, 1240):
            clock.wait_until(clock.now() + 2_000_000)
        return OperatorCommand(True, False)

    ended = session.run(OperatorCommand(True, False), None, each)
    bus.close()
    assert ended.safety_state.reason is ends
    assert max(each.tip[2] for each in seen) - seen[0].tip[2] < 0.005


@pytest.mark.parametrize(("angle", "ends"), [(0.25, Reason.FINISHED), (-0.35, Reason.POSTURE), (0.35, Reason.POSTURE)])
def test_the_approach_begins_near_the_posture_of_the_controller_or_not_at_all(plain, angle, ends):
    twin, session, bus = _begun(plain)
    cycles = 0

    def each(result):
        nonlocal cycles
        cycles += 1
        assert result.safety_state.state is not OperatingState.APPROACH
        if cycles == MOVED:
            twin.carry(_turned(twin, angle), 1.0)
        return OperatorCommand(True, False, Reason.FINISHED if cycles > ACTIVATED else Reason.NONE)

    ended = session.run(OperatorCommand(True, False), None, each).safety_state
    bus.close()
    assert (ended.state, ended.reason) == (OperatingState.STOPPED, ends)
    assert ended.detail.startswith("joint 1 stands at ") == (ends is Reason.POSTURE)


def test_an_arm_that_was_moved_while_its_controller_was_named_is_told(plain):
    twin, session, bus = _begun(plain)
    session.unmoved()
    twin.carry(_turned(twin, 0.01), 0.0)
    session.unmoved()
    twin.carry(_turned(twin, 0.2), 0.0)
    with pytest.raises(CalibrationError, match=r"^J1 has moved since the arm was started"):
        session.unmoved()
    bus.close()


def test_another_program_that_commands_meanwhile_is_not_disturbed(plain):
    twin, session, bus = _begun(plain)
    twin._wire.post(Frame(0x404, b"\x30"), twin.now_ns)
    session._clock.wait_until(twin.now_ns + 1_000_000)
    sent = bus.counters.sent
    with pytest.raises(BusError, match=r"somebody else commands on this bus.*nothing was sent"):
        session.unmoved()
    assert bus.counters.sent == sent
    bus.close()
