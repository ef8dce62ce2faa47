"""Bounds that are times stay so at any rate of the controller: no cycle that lasts longer stretches them."""

import pytest

from deploy.durations import cycles
from deploy.force.can_sensor import CanSensor
from deploy.loop.hazards import CycleTiming
from deploy.puck import codec
from deploy.puck.codec import SAFETY_MODULE
from deploy.safety import machine
from deploy.safety.force_balance import BalanceState, balance_step
from deploy.safety.late_force import LATE, late_step
from deploy.safety.machine import BRIDGED, Observations, OperatingState, SafetyState, Task
from deploy.safety.reasons import Reason
from tests.deploy.test_hazards import Judge
from tests.deploy.wire import FORCE, MOMENT, Rig, positions, whole

RATES = pytest.mark.parametrize("T_s", [2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 1e-2])


def test_a_time_is_at_least_as_many_cycles_as_are_asked_for():
    assert [cycles(0.02, T_s) for T_s in (1e-3, 3e-3, 0.1)] == [20, 7, 1]
    assert cycles(0.02, 0.1, BRIDGED) == 2


@pytest.mark.parametrize(("T_s", "held"), [(1e-4, 200), (1e-3, 20), (3e-3, 7), (0.0115, 2), (0.1, 2)])
def test_positions_hold_the_arm_for_twenty_milliseconds(T_s, held):
    waits, old = machine.patience(T_s), SafetyState(OperatingState.FAULT, Reason.POSITION_OLD)
    assert machine.task_of(old, held, waits) is Task.GRAVITY
    assert machine.task_of(old, held + 1, waits) is Task.OFF
    lost = machine.step(SafetyState(OperatingState.CONTACT), Observations(position_age=held + 1), waits)
    assert lost.reason is Reason.POSITION_LOST


@RATES
def test_pendant_and_operator_are_waited_for_ten_minutes(T_s):
    waits = machine.patience(T_s)
    assert (waits.idle * T_s, waits.armed * T_s) == pytest.approx((0.5, 600.0))
    before = SafetyState(OperatingState.ARMED, cycles=waits.armed - 2)
    assert machine.step(before, Observations(), waits).state is OperatingState.ARMED
    assert machine.step(before._replace(cycles=waits.armed - 1), Observations(), waits).reason is Reason.NOT_STARTED


@RATES
def test_a_silent_safety_module_is_missed_after_a_tenth_of_a_second_and_ten_questions(T_s):
    judge = Judge(T_s)
    silent = max(round(0.1 / T_s), 20 * cycles(5e-3, T_s))
    assert judge(safety_age=silent)[0] is Reason.NONE
    assert judge(safety_age=silent + 1) == (Reason.PENDANT_FAULT, "the safety module is silent")
    assert silent * T_s <= 0.2


@RATES
def test_a_puck_that_does_not_tell_its_state_is_missed_after_half_a_second_and_six_rounds_of_polls(T_s):
    judge = Judge(T_s)
    untold = max(round(0.5 / T_s), 6 * 16 * cycles(5e-3, T_s))
    assert judge(puck_age=(0, 0, 0, untold))[0] is Reason.NONE
    assert judge(puck_age=(0, 0, 0, untold + 1))[0] is Reason.PUCK_FAULT
    assert untold * T_s <= 1.0


@RATES
def test_every_puck_is_heard_in_every_round_of_polls(T_s):
    """Its states come, and make it no older than a round."""
    rig, oldest = Rig(T_s=T_s), 0
    for _ in range(3 * 16 * cycles(5e-3, T_s)):
        asked = rig.wire.sent[-1] if rig.wire.sent else None
        told = []
        if asked is not None and 1 <= asked.id <= 4:
            told = [codec.encode_property(asked.id, asked.data[0], 2)]
        oldest = max(oldest, *rig.cycle(*whole(), *told).puck_age)
    assert oldest <= 16 * cycles(5e-3, T_s) + 1


@RATES
def test_lateness_explains_for_a_second(T_s):
    judge = Judge(T_s)
    judge(CycleTiming(missed=1))
    judge.arm.cycle += round(1.0 / T_s) - 2
    assert judge(youngest=BRIDGED)[0] is Reason.NONE
    assert judge(youngest=BRIDGED)[0] is Reason.POSITION_LOST


@pytest.mark.parametrize(("T_s", "frames"), [(5e-4, 2), (1e-3, 4), (2e-3, 8)])
def test_a_babbling_node_is_one_that_fills_half_of_the_bus(T_s, frames):
    for each, found in ((frames - 1, Reason.NONE), (frames, Reason.BUS_LOAD)):
        judge = Judge(T_s)
        for _ in range(2):
            judge.arm.bus.counters.foreign += each
            reason, _ = judge()
        assert reason is found


@RATES
def test_states_are_asked_for_fifty_times_a_second(T_s):
    rig = Rig(T_s=T_s)
    for _ in range(round(1.0 / T_s)):
        rig.cycle(*whole())
    asked_pen = sum(frame == codec.get(SAFETY_MODULE, 43) for frame in rig.wire.sent)
    assert asked_pen == pytest.approx(min(50, 0.25 / T_s), rel=0.3)  # in whole cycles


@RATES
def test_a_reply_that_is_missing_is_waited_for_twenty_milliseconds(T_s):
    rig, sensor, doubtful = Rig(T_s=T_s), CanSensor(T_s=T_s), round(0.02 / T_s)
    rig.cycle(*whole())
    rig.cycle(*positions(nodes=(1, 2, 3)), FORCE, MOMENT)
    waited = []
    for _ in range(doubtful + 3):
        start = rig.wire.now_ns
        rig.arm.request()
        for frame in whole():
            rig.wire.put(frame, start + 50_000)
        rig.arm.collect(start + 600_000)
        waited.append(rig.wire.now_ns - start)
    assert waited == [600_000] * doubtful + [50_000] * 3
    sensor.request()
    sensor.request()
    ready = []
    for _ in range(doubtful + 1):
        for frame in (FORCE, MOMENT):
            sensor.feed(frame)
        ready.append(sensor.ready)
        sensor.request()
    assert ready == [False] * doubtful + [True]


@RATES
def test_the_air_is_learned_for_a_fifth_of_a_second(T_s):
    state, none = BalanceState(), (0.0, 0.0, 0.0)
    for k in range(round(0.4 / T_s)):
        assert not state.known
        told = -2.0 if k >= round(0.2 / T_s) else 1.0
        state, _ = balance_step(state, (0.0, 0.0, told), none, none, (0.0, 0.0, 1.0), True, T_s)
    assert state.known
    assert state.samples * T_s == pytest.approx(0.2)
    assert state.air == pytest.approx(2.0)


@RATES
def test_a_late_force_is_one_for_twenty_milliseconds(T_s):
    count, found = 0, []
    for _ in range(round(0.02 / T_s)):
        count, reason = late_step(count, (2.0 * LATE,) * 3, T_s)
        found.append(reason)
    assert found == [None] * (len(found) - 1) + [Reason.FORCE_MODEL]
