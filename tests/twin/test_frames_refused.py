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


@pytest.mark.parametrize("refused_ms", [3, 10, 30, 300])
def test_the_arm_is_let_go_once_frames_are_taken_again(plain, refused_ms):
    """The safety module's own patience with a silent bus is set so long that it cannot help."""
    twin = Twin(TwinSettings(gap=0.003, motion=motion_named("none"), heartbeat_s=10.0))
    clock = LockstepClock(twin)
    driver, watchdog, log = Refusing(clock), Watchdog(), []
    bus = Bus(driver, clock.now)
    options = Options(
        from_words("0,0,-5@2", rate=5.0, largest=10.0),
        turns=False,
        tare=False,
        log=lambda frame, stamp, sent: log.append((stamp, frame.id, frame.data)),
    )
    session = Session(plain, bus, clock, options, lambda sentence: None)
    cycles = 0

    def each(result):
        nonlocal cycles
        cycles += 1
        if cycles == 50:
            twin.press("activate")
        if cycles == CONTACT:
            assert result.safety_state.state is OperatingState.CONTACT
            driver.begins = clock.now() + MS // 10
            driver.ends = driver.begins + refused_ms * MS
        return OperatorCommand(True, True)

    ended = session.run(OperatorCommand(True, True), watchdog, each)
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.BUS_ERROR)
    assert not any(puck.driving for puck in twin.pucks)
    idle = next(at for at, number, data in driver.taken if at >= driver.ends and number == 0x404 and data[0] & 0x80)
    assert all(
        on for at, on in watchdog.beats if driver.begins <= at < idle - MS
    )  # it would have acted, had the controller died meanwhile
    if refused_ms <= 10:
        assert not watchdog.beats[-1][1]
    else:
        # Beats have ended, and with torques on: the watchdog has tried by a connection of its own.
        assert watchdog.beats[-1][1]
        assert idle - watchdog.beats[-1][0] > 100 * MS
    torques = [(at, number, data) for at, number, data in driver.taken if number == 0x401]
    assert [each[1:] for each in log] == [each[1:] for each in torques][-len(log) :]


def test_a_program_that_fails_while_frames_are_refused_lets_go_all_the_same(plain):
    twin = Twin(TwinSettings(gap=0.003, motion=motion_named("none"), heartbeat_s=10.0))
    clock = LockstepClock(twin)
    driver, cycles = Refusing(clock), 0
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False)
    session = Session(plain, Bus(driver, clock.now), clock, options, lambda sentence: None)

    def each(result):
        nonlocal cycles
        cycles += 1
        if cycles == 50:
            twin.press("activate")
        if cycles == CONTACT:
            driver.begins, driver.ends = clock.now(), clock.now() + 30 * MS
            session.arm.bus.send(Frame(0x404, b"\x30"))
            raise RuntimeError("a defect")
        return OperatorCommand(True, True)

    with pytest.raises(RuntimeError, match="a defect"):
        session.run(OperatorCommand(True, True), Watchdog(), each)
    assert not any(puck.driving for puck in twin.pucks)
