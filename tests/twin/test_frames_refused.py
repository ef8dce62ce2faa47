"""A bus that takes no frame for some milliseconds: the arm is let go all the same, and nobody is told before it is."""

import can
import pytest

from deploy.bus.bus import Bus
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

pytestmark = pytest.mark.once

CONTACT = 2500
"""Cycle at which the force is held."""
MS = 1_000_000


class Refusing(LockstepBus):
    """Takes nothing for a time; `taken` is the rest."""

    def __init__(self, clock):
        super().__init__(clock)
        self.now, self.taken, self.begins, self.ends = clock.now, [], float("inf"), float("inf")

    def send(self, msg, timeout=None):
        if self.begins <= self.now() < self.ends:
            raise can.CanOperationError("Transmit buffer full")
        self.taken.append((self.now(), msg.arbitration_id, bytes(msg.data)))
        super().send(msg, timeout)


class Watchdog:
    fired = False

    def __init__(self):
        self.beats = []

    def beat(self, now, torques_on):
        self.beats.append((now, torques_on))

    def answers(self, now):
        return True


def fly(plain, driver, clock, happen, log=None):
    """A run in which something happens in contact; how it ended, and the watchdog's beats."""
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False, log=log)
    bus = Bus(driver, clock.now)
    session = Session(plain, bus, clock, options, lambda sentence: None)
    watchdog, cycles = Watchdog(), 0

    def each(result):
        nonlocal cycles
        cycles += 1
        if cycles == 50:
            clock.twin.press("activate")
        if cycles == CONTACT:
            assert result.safety_state.state is OperatingState.CONTACT
            happen(session)
        return OperatorCommand(True, True)

    try:
        return session.run(OperatorCommand(True, True), watchdog, each), watchdog.beats
    finally:
        bus.close()


@pytest.fixture
def clock():
    """Of a twin whose safety module is so patient with a silent bus that it cannot help."""
    return LockstepClock(Twin(TwinSettings(gap=0.003, motion=motion_named("none"), heartbeat_s=10.0)))


@pytest.mark.parametrize("refused_ms", [3, 10, 30, 300])
def test_the_arm_is_let_go_once_frames_are_taken_again(plain, clock, refused_ms):
    driver, log = Refusing(clock), []

    def happen(session):
        driver.begins = clock.now() + MS // 10
        driver.ends = driver.begins + refused_ms * MS

    ended, beats = fly(plain, driver, clock, happen, lambda frame, stamp, sent: log.append((frame.id, frame.data)))
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.BUS_ERROR)
    assert not any(puck.driving for puck in clock.twin.pucks)
    idle = next(at for at, number, data in driver.taken if at >= driver.ends and number == 0x404 and data[0] & 0x80)
    # Until then the watchdog would have acted, had the controller died.
    assert all(on for at, on in beats if driver.begins <= at < idle - MS)
    if refused_ms <= 10:
        assert not beats[-1][1]
    else:
        # Beats have ended, and with torques on: the watchdog has tried by a connection of its own.
        assert beats[-1][1]
        assert idle - beats[-1][0] > 100 * MS
    assert log == [(number, data) for _, number, data in driver.taken if number == 0x401]


def test_a_program_that_fails_while_frames_are_refused_lets_go_all_the_same(plain, clock):
    driver = Refusing(clock)

    def happen(session):
        driver.begins, driver.ends = clock.now(), clock.now() + 30 * MS
        session.arm.bus.send(Frame(0x404, b"\x30"))
        raise RuntimeError("a defect")

    with pytest.raises(RuntimeError, match="a defect"):
        fly(plain, driver, clock, happen)
    assert not any(puck.driving for puck in clock.twin.pucks)


def test_the_order_to_idle_is_given_again_and_again_since_a_frame_can_be_lost(plain, clock):
    driver = Refusing(clock)

    def happen(session):
        raise RuntimeError("a defect")

    with pytest.raises(RuntimeError, match="a defect"):
        fly(plain, driver, clock, happen)
    orders = [at for at, number, data in driver.taken if number == 0x404 and data[0] & 0x80]
    later = [at - orders[-1] for at in orders if at > orders[-1] - 45 * MS]
    assert later == [-40 * MS, -30 * MS, -20 * MS, -10 * MS, 0]
