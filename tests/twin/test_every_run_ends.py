"""Every state × every hazard × every signal, before and after arming: the run ends, soon, and says why."""

from functools import cache
from itertools import product
from types import SimpleNamespace

import pytest

from deploy.loop import loop
from deploy.loop.control import Contacting
from deploy.loop.loop import LETTING_GO, LINGER
from deploy.loop.operator import Operator
from deploy.safety.machine import IDLE_PATIENCE, OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.flight import started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.scenario import twin_settings
from deploy.twin.twin import Twin
from tests.deploy.made import arm_artifact
from tests.twin.flying import HELD

pytestmark = pytest.mark.usefixtures("held_briefly", "recorded_once")
SOON = 1.0
"""Within which a reason is named [s]; the arm is then let go at once, or held or withdrawn for its known time."""
CONTACTING = Contacting(retract_distance=0.003)
WITHDRAWN = 2 * CONTACTING.retract_distance / CONTACTING.retract_speed
"""Longest retraction [s]."""
WAITS = 0.06
"""Time in IDLE before the operator arms [s]."""
frozen = cache(arm_artifact)
HAZARDS = (
    *("pendant:e-stop", "pendant:idle"),
    *("puck2:fault", "puck3:mute", "puck4:off", "puck1:reset", "bus:off", "bus:babble=8000"),
    *("frames:lost=0.999", "frames:late=2", "positions:lost=3", "J2:lost=25", "J3:jump", "J4:garbage"),
    *("force:off", "force:nan", "force:stuck", "force:jump", "commands:lost=0.999"),
    *("watchdog:fired", "watchdog:gone", "clock:stalled", "clock:late"),
)
HARMLESS = {"commands:lost=0.999", "clock:late"}
"""What a short run may bridge, or what another part of the robot answers."""
SIGNALS = (0, 1, 2)
STATES = tuple(OperatingState)


class Watchdog:
    fired, there = False, True

    def beat(self, now, torques_on):
        pass

    def answers(self, now):
        return self.there


def fly(hazard="", at=None, signals=0, first="", duration=0.1):
    """A short run with a hazard and so many signals from a time on; what it was, cycle by cycle."""
    target, _, word = hazard.partition(":")
    ours = target in ("watchdog", "clock")
    faults = tuple(f"{each}@{when}" for each, when in ((first, at and at - 0.02), ("" if ours else hazard, at)) if each)
    twin = Twin(twin_settings(gap=0.0003, rhythm="none", faults=faults))
    clock, watchdog, count = LockstepClock(twin), Watchdog(), SimpleNamespace(count=0)
    flight, bus = started(frozen(), clock, "0,0,-1@5", 5.0, tare=False, contacting=CONTACTING)
    console = SimpleNamespace(say=lambda line: None)
    operator = Operator(console, count, lambda: flight.controller.contact_time, duration, True, False)
    seen = []

    def each(result):
        now = 1e-9 * clock.now()
        seen.append((now, result.safety_state))
        if result.safety_state.state is OperatingState.ARMED and result.safety_state.cycles == 50:
            twin.press("activate")
        if at is not None and now >= at:
            count.count = signals
            watchdog.fired, watchdog.there = hazard == "watchdog:fired", hazard != "watchdog:gone"
            if target == "clock":  # once, by 100 ms; or in every cycle, by one
                once = 100_000_000 if now < at + 1.5e-3 else 0
                clock.wait_until(clock.now() + (once if word == "stalled" else 1_500_000))
        command = operator.each(result)
        return command if now > seen[0][0] + WAITS else command._replace(armed=False)

    ended = flight.run(operator.command._replace(armed=False), watchdog, each)
    bus.close()
    return ended, seen, 1e-9 * clock.now()


@cache
def moments():
    """A time within each state of an undisturbed run [s]."""
    ended, seen, _ = fly()
    assert ended.well
    found = {}
    for state in OperatingState:
        times = [time for time, now in seen if now.state is state]
        if times:
            found[state] = times[0] + min(0.5 * (times[-1] - times[0]), 0.05)
    assert set(found) == set(OperatingState) - {OperatingState.FAULT}
    return found | {OperatingState.FAULT: found[OperatingState.CONTACT]}


@cache
def check(state, hazard, signals):
    """Once for each: a flight in lock-step is the same every time."""
    at = round(moments()[state], 3)
    ended, seen, end = fly(hazard, at, signals, "J2:lost=3" if state is OperatingState.FAULT else "")
    assert any(time >= at - 2e-3 and now.state is state for time, now in seen), "the state was not met"
    now = ended.safety_state
    assert now.over
    assert now.reason is not Reason.NONE
    before = next(known.reason for time, known in reversed(seen) if time < at)
    if signals or hazard not in HARMLESS:
        named = next(time for time, known in seen if time >= at and known.reason is not Reason.NONE)
        assert named - at <= SOON
        held = 0.0 if signals == 2 or now.let_go else HELD
        assert end - at <= SOON + WITHDRAWN + held + 2 * LETTING_GO
    if now.let_go and state in (OperatingState.IDLE, OperatingState.ARMED):
        assert end - at <= SOON
    if signals == 2:
        assert end - at <= SOON
    return before, now


def test_a_run_that_is_over_holds_the_arm_for_a_second(monkeypatch):
    monkeypatch.setattr(loop, "LINGER", LINGER)
    _, seen, end = fly()
    over = next(time for time, now in seen if now.over)
    assert end - over == pytest.approx(1.0 + LETTING_GO, abs=0.01)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("signals", SIGNALS)
def test_every_signal_ends_every_state(state, signals):
    before, now = check(state, "", signals)
    if signals and state not in (OperatingState.RETRACT, OperatingState.STOPPED, OperatingState.FAULT):
        assert now.reason is Reason.OPERATOR
    assert (now.state is OperatingState.FAULT) >= (signals == 2 and before is Reason.NONE)


@pytest.mark.parametrize("hazard", HAZARDS)
def test_every_hazard_ends_a_run_that_is_not_armed_yet(hazard):
    check(OperatingState.IDLE, hazard, 0)


@pytest.mark.oracle
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("hazard", HAZARDS)
def test_every_state_hazard_and_signal(state, hazard):
    for signals in SIGNALS:
        check(state, hazard, signals)


def test_an_arm_that_is_never_armed_or_activated_is_not_waited_for_for_ever():
    twin = Twin(twin_settings(gap=0.001, rhythm="none"))
    clock = LockstepClock(twin)
    flight, bus = started(frozen(), clock, "0,0,-1@5", 5.0, tare=False)
    operator = Operator(SimpleNamespace(say=print), SimpleNamespace(count=0), lambda: 0.0, 1.0, True, False)
    began = clock.now()
    ended = flight.run(
        operator.command._replace(armed=False), None, lambda result: operator.each(result)._replace(armed=False)
    )
    bus.close()
    assert (ended.safety_state.state, ended.safety_state.reason) == (OperatingState.STOPPED, Reason.NOT_STARTED)
    assert ended.safety_state.let_go
    assert (clock.now() - began) * 1e-6 <= 1e3 * IDLE_PATIENCE + 200


def test_there_are_as_many_pairs_as_are_said():
    assert len(list(product(STATES, HAZARDS, SIGNALS))) == 7 * 23 * 3
