"""The loop itself, in lock-step: clocks that jump, watchdogs that act or are gone, and a defect of the program."""

import pytest

from deploy.bus.bus import Bus
from deploy.errors import BusError
from deploy.loop.cycle import Cycle, OperatorCommand
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.puck.codec import unpack_torques
from deploy.puck.frame import Frame
from deploy.reference.segments import from_words
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact

pytestmark = pytest.mark.once

AT = 1200
"""The cycle in which it happens: in contact."""


class Watchdog:
    def __init__(self):
        self.fired, self.there, self.beats = False, True, []

    def beat(self, now, torques_on):
        self.beats.append((now, torques_on))

    def answers(self, now):
        return self.there


@pytest.fixture
def run():
    """Fly; `happen(clock, watchdog)` is called within cycle `AT`."""

    def fly(happen):
        twin = Twin(TwinSettings(gap=0.003, motion=motion_named("none")))
        clock = LockstepClock(twin)
        frames = []
        bus = Bus(LockstepBus(clock), clock.now)

        def log(frame, stamp, sent):
            frames.append((stamp, any(unpack_torques(frame.data))))

        options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False, log=log)
        session = Session(arm_artifact(), bus, clock, options, lambda sentence: None)
        watchdog, cycles, when = Watchdog(), [], []

        def each(result):
            cycles.append(result.safety_state)
            if len(cycles) == 50:
                twin.press("activate")
            if len(cycles) == AT:
                assert result.safety_state.state is OperatingState.CONTACT
                when.append(clock.now())
                happen(clock, watchdog)
            return OperatorCommand(True, True, Reason.FINISHED if len(cycles) > AT + 300 else Reason.NONE)

        try:
            ended = session.run(OperatorCommand(True, True), watchdog, each)
        finally:
            bus.close()
            driven = [stamp for stamp, drives in frames if when and stamp > when[0] and drives]
            watchdog.driven, watchdog.mode = driven, twin.safety.mode
            watchdogs.append(watchdog)
        return ended, session

    watchdogs = []
    fly.watchdogs = watchdogs
    return fly


def test_after_standing_still_nothing_is_computed_from_what_is_old(run):
    ended, session = run(lambda clock, _: clock.wait_until(clock.now() + 100_000_000))
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.STALLED)
    (watchdog,) = run.watchdogs
    assert watchdog.driven == []
    assert watchdog.mode == 1
    assert session.statistics.overruns == 1


def test_stopped_between_measuring_and_sending_the_torque_is_not_sent(run, monkeypatch):
    step, stopped, measured_at = Cycle.step, [], []

    def stop_once_computed(cycle, *measured):
        result = step(cycle, *measured)
        if stopped and any(result.applied):
            clock = stopped.pop()
            measured_at.append(clock.now())
            clock.wait_until(clock.now() + 100_000_000)
        return result

    monkeypatch.setattr(Cycle, "step", stop_once_computed)
    ended, _ = run(lambda clock, _: stopped.append(clock))
    assert not stopped
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.STALLED)
    (watchdog,) = run.watchdogs
    assert watchdog.driven == []
    # A beat says when it was measured, not when it was sent: else the watchdog would not see that it stopped.
    assert min(abs(at - measured_at[0]) for at, _ in watchdog.beats) < 900_000


def test_once_the_watchdog_has_acted_the_torque_of_that_very_cycle_is_not_sent(run, monkeypatch):
    step, watched = Cycle.step, []

    def act_once_computed(cycle, *measured):
        result = step(cycle, *measured)
        if watched and any(result.applied):
            watched.pop().fired = True
        return result

    monkeypatch.setattr(Cycle, "step", act_once_computed)
    ended, _ = run(lambda _, watchdog: watched.append(watchdog))
    assert not watched
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.STALLED)
    (watchdog,) = run.watchdogs
    assert watchdog.driven == []


def test_a_few_missed_cycles_end_in_holding(run):
    ended, _ = run(lambda clock, _: clock.wait_until(clock.now() + 8_000_000))
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, Reason.LATE)
    (watchdog,) = run.watchdogs
    assert len(watchdog.driven) > 500  # gravity, for a second


def test_one_missed_cycle_is_counted_and_flown_over(run):
    ended, session = run(lambda clock, watchdog: (clock.wait_until(clock.now() + 2_000_000), watchdog.beats.clear()))
    assert session.statistics.overruns == 1
    assert ended.safety_state.reason is not Reason.LATE


@pytest.mark.parametrize("reason", [Reason.STALLED, Reason.WATCHDOG])
def test_a_watchdog_that_has_acted_or_is_gone_lets_go_at_once(run, reason):
    def happen(clock, watchdog):
        watchdog.fired, watchdog.there = reason is Reason.STALLED, reason is not Reason.WATCHDOG

    ended, _ = run(happen)
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.FAULT, reason)
    (watchdog,) = run.watchdogs
    assert watchdog.driven == []
    assert [on for _, on in watchdog.beats[:AT]] == [True] * AT
    assert not any(on for _, on in watchdog.beats[-20:])


def test_who_was_forestalled_while_the_operator_was_waited_for_sends_nothing_and_stops_nobody():
    clock = LockstepClock(Twin(TwinSettings(motion=motion_named("none"))))
    options = Options(from_words("0,0,-5@2", rate=5.0, largest=10.0), turns=False, tare=False)
    session = Session(arm_artifact(), Bus(LockstepBus(clock), clock.now), clock, options, lambda sentence: None)
    first = Bus(LockstepBus(clock), clock.now)
    first.send(Frame(0x404, b"\x30"))
    clock.wait_until(clock.now() + 5_000_000)
    first.flush()
    received, hosts = clock.twin.counters["received"], first.counters.hosts
    with pytest.raises(BusError, match="somebody else commands"):
        session.run(OperatorCommand(True, True), None, lambda result: OperatorCommand(True, True))
    assert clock.twin.counters["received"] == received
    first.flush()
    assert first.counters.hosts == hosts


def test_a_defect_of_the_program_lets_go_before_it_is_told(run):
    def happen(clock, watchdog):
        raise RuntimeError("a defect")

    with pytest.raises(RuntimeError, match="a defect"):
        run(happen)
    (watchdog,) = run.watchdogs
    assert watchdog.driven == []
    assert watchdog.mode == 1
