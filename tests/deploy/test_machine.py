from itertools import product

import pytest

from deploy.safety import machine
from deploy.safety.machine import BRIDGED, CONTACT_CYCLES, Observations, OperatingState, SafetyState, Task, patience
from deploy.safety.reasons import EXPLANATION, Reason

UP = {
    OperatingState.IDLE: {OperatingState.ARMED, OperatingState.STOPPED, OperatingState.FAULT},
    OperatingState.ARMED: {OperatingState.APPROACH, OperatingState.STOPPED, OperatingState.FAULT},
    OperatingState.APPROACH: {OperatingState.CONTACT, OperatingState.RETRACT, OperatingState.FAULT},
    OperatingState.CONTACT: {OperatingState.RETRACT, OperatingState.FAULT},
    OperatingState.RETRACT: {OperatingState.STOPPED, OperatingState.FAULT},
    OperatingState.STOPPED: {OperatingState.FAULT},
    OperatingState.FAULT: set(),
}
NONE = Reason.NONE
READY = Observations(active=True)
WAITS = patience(1e-3)
HELD = WAITS.held


def step(now, observed):
    return machine.step(now, observed, WAITS)


def task_of(now, age):
    return machine.task_of(now, age, WAITS)


def walk(*seen, start=None):
    now = start or SafetyState()
    for each in seen:
        now = step(now, each)
    return now


def everything():
    """Every kind of thing that a cycle can see, together with every other."""
    hazards = (Reason.NONE, Reason.E_STOP, Reason.STALLED)
    ages = (0, BRIDGED, BRIDGED + 1, HELD, HELD + 1)
    bits = (False, True)
    for hazard, age, danger, doubt, finish in product(
        hazards, ages, (NONE, Reason.WORKSPACE, Reason.LATE), (NONE, Reason.FORCE_LOST), (NONE, Reason.OPERATOR)
    ):
        for active, touching, travelled, armed, start, abort in product(bits, repeat=6):
            yield Observations(hazard, age, danger, doubt, "", active, touching, travelled, armed, start, finish, abort)


def test_only_the_arrows_are_walked_whatever_is_seen():
    for state in OperatingState:
        for reason in (NONE, Reason.FORCE_LOST, Reason.E_STOP):
            now = SafetyState(state, reason, contact_cycles=CONTACT_CYCLES - 1)
            found = {step(now, seen).state for seen in everything()} - {state}
            assert found == UP[state]


def test_the_way_up():
    now = walk(Observations())
    assert now.state is OperatingState.ARMED
    now = walk(READY._replace(start=False), READY, start=now)
    assert now.state is OperatingState.APPROACH
    now = walk(*[READY._replace(touching=True)] * CONTACT_CYCLES, start=now)
    assert now.state is OperatingState.CONTACT
    now = walk(READY._replace(finish=Reason.FINISHED), start=now)
    assert (now.state, now.reason) == (OperatingState.RETRACT, Reason.FINISHED)
    now = walk(READY._replace(travelled=True), start=now)
    assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.FINISHED)
    assert now.over


@pytest.mark.parametrize("reason", [Reason.FINISHED, Reason.OPERATOR, Reason.OVERSHOOT, Reason.NO_CONTACT])
def test_a_force_beyond_the_limit_on_the_way_out_is_no_good_end(reason):
    """A beat may meet the tip while it withdraws, which it goes on to do."""
    now = step(SafetyState(OperatingState.RETRACT, reason), READY._replace(doubt=Reason.FORCE))
    assert (now.state, now.reason, task_of(now, 0)) == (OperatingState.RETRACT, Reason.FORCE, Task.RETRACT)
    now = walk(READY, READY._replace(travelled=True), start=now)
    assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.FORCE)
    # Nothing else of the force matters there, and what ended contact before stays told.
    other = step(SafetyState(OperatingState.RETRACT, reason), READY._replace(doubt=Reason.FORCE_LOST))
    assert other.reason is reason
    before = SafetyState(OperatingState.RETRACT, Reason.FORCE_LOST)
    assert step(before, READY._replace(doubt=Reason.FORCE)).reason is Reason.FORCE_LOST


@pytest.mark.parametrize("reason", [Reason.FINISHED, Reason.OPERATOR])
def test_a_push_much_beyond_the_wanted_one_on_the_way_out_is_told(reason):
    more = READY._replace(finish=Reason.OVERSHOOT)
    now = step(SafetyState(OperatingState.RETRACT, reason), more)
    assert (now.state, now.reason, task_of(now, 0)) == (OperatingState.RETRACT, Reason.OVERSHOOT, Task.RETRACT)
    assert step(now, READY._replace(doubt=Reason.FORCE)).reason is Reason.FORCE
    # What ended contact otherwise stays told.
    for other in (Reason.NO_CONTACT, Reason.FORCE_LOST):
        assert step(SafetyState(OperatingState.RETRACT, other), more).reason is other


@pytest.mark.parametrize("seen", [{"doubt": Reason.FORCE}, {"finish": Reason.OVERSHOOT}])
def test_whoever_touches_an_arm_that_has_withdrawn_makes_no_good_end_a_bad_one(seen):
    now = step(SafetyState(OperatingState.STOPPED, Reason.FINISHED), READY._replace(**seen))
    assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.FINISHED)


def test_an_arm_that_was_let_go_where_it_stopped_may_idle():
    """The pucks of the robot go idle then, and their counts may stay out: that was ordered."""
    now = step(SafetyState(OperatingState.STOPPED, Reason.FINISHED), READY._replace(abort=True))
    now = walk(READY._replace(hazard=Reason.E_STOP), READY._replace(position_age=HELD + 1), start=now)
    assert (now.state, now.reason, task_of(now, 0)) == (OperatingState.STOPPED, Reason.FINISHED, Task.OFF)


def test_a_touch_must_last():
    touching = READY._replace(touching=True)
    now = walk(
        *[touching] * (CONTACT_CYCLES - 1),
        READY,
        *[touching] * (CONTACT_CYCLES - 1),
        start=SafetyState(OperatingState.APPROACH),
    )
    assert now.state is OperatingState.APPROACH


def test_nothing_begins_without_the_operator_the_pendant_and_every_position():
    assert walk(Observations(armed=False)).state is OperatingState.IDLE
    assert walk(Observations(position_age=1)).state is OperatingState.IDLE
    armed = SafetyState(OperatingState.ARMED)
    assert step(armed, Observations(active=False)).state is OperatingState.ARMED
    assert step(armed, READY._replace(start=False)).state is OperatingState.ARMED


def test_no_approach_begins_with_what_reads_as_a_contact():
    armed, touching = SafetyState(OperatingState.ARMED), READY._replace(touching=True)
    for count in range(1, CONTACT_CYCLES):
        assert walk(*[touching] * count, start=armed).state is OperatingState.ARMED
        assert walk(*[touching] * count, READY, start=armed).state is OperatingState.APPROACH
    now = walk(*[touching] * CONTACT_CYCLES, start=armed)
    assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.TARE)
    # Before, the arm may be carried by its tool.
    carried = walk(*[touching._replace(start=False)] * 50, start=armed)
    assert step(carried, READY).state is OperatingState.APPROACH
    assert step(carried, touching).reason is Reason.TARE


@pytest.mark.parametrize(
    "state",
    [
        OperatingState.ARMED,
        OperatingState.APPROACH,
        OperatingState.CONTACT,
        OperatingState.RETRACT,
        OperatingState.STOPPED,
    ],
)
@pytest.mark.parametrize("hazard", [reason for reason in Reason if reason.lets_go])
def test_a_hazard_lets_go_within_the_cycle_and_never_comes_back(state, hazard):
    now = step(SafetyState(state), READY._replace(hazard=hazard, detail="puck 3"))
    assert (now.state, now.reason, now.detail) == (OperatingState.FAULT, hazard, "puck 3")
    assert task_of(now, 0) is Task.OFF
    later = [step(now, seen) for seen in everything()]
    causes = {hazard} | ({Reason.LATE, Reason.E_STOP, Reason.STALLED} if hazard is Reason.POSITION_LOST else set())
    assert {each.reason for each in later} == causes
    assert all(each.state is OperatingState.FAULT and task_of(each, 0) is Task.OFF for each in later)


@pytest.mark.parametrize("state", [each for each in OperatingState if each is not OperatingState.FAULT])
@pytest.mark.parametrize("reason", [each for each in Reason if each is not NONE])
@pytest.mark.parametrize("asked", [NONE, Reason.OPERATOR])
def test_every_state_looks_at_every_hazard_danger_doubt_and_at_the_operator(state, reason, asked):
    for abort in (False, True):
        for kind in ("hazard", "danger", "doubt"):
            seen = Observations(finish=asked, abort=abort)._replace(**{kind: reason})
            now = step(SafetyState(state), seen)
            if state in (OperatingState.RETRACT, OperatingState.STOPPED) and kind == "doubt" and not abort:
                continue  # the force ends contact, and there is none
            assert now.state is not state or state is OperatingState.STOPPED
            assert now.reason is not NONE or state is OperatingState.STOPPED
            assert now.reason in (reason, asked, Reason.OPERATOR) or state is OperatingState.STOPPED
            assert task_of(now, 0) is Task.OFF or not (abort or state is OperatingState.IDLE)


@pytest.mark.parametrize("state", OperatingState)
def test_the_second_signal_lets_go_in_every_state(state):
    now = step(
        SafetyState(state, Reason.WORKSPACE if state is OperatingState.FAULT else NONE), READY._replace(abort=True)
    )
    assert now.over
    assert task_of(now, 0) is Task.OFF
    assert task_of(step(now, READY), 0) is Task.OFF


def test_what_is_waited_for_in_vain_ends():
    for state, waited, seen in (
        (OperatingState.IDLE, 500, Observations(armed=False)),
        (OperatingState.IDLE, 500, Observations(position_age=BRIDGED)),
        (OperatingState.ARMED, 600_000, Observations(active=False)),
        (OperatingState.ARMED, 600_000, READY._replace(start=False)),
    ):
        assert step(SafetyState(state, cycles=waited - 2), seen).state is state
        now = step(SafetyState(state, cycles=waited - 1), seen)
        assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.NOT_STARTED)
        assert (task_of(now, 0) is Task.OFF) == (state is OperatingState.IDLE)


@pytest.mark.parametrize(("state", "waits"), [("IDLE", WAITS._replace(idle=3)), ("ARMED", WAITS._replace(armed=3))])
def test_every_cycle_of_waiting_counts(state, waits):
    now, ends = SafetyState(OperatingState[state]), []
    for _ in range(3):
        now = machine.step(now, Observations(armed=False, start=False), waits)
        ends.append(now.over)
    assert ends == [False, False, True]


def test_who_was_silent_besides_is_told_while_the_arm_is_let_go():
    lost = step(SafetyState(OperatingState.CONTACT), READY._replace(hazard=Reason.POSITION_LOST, detail="no puck"))
    now = step(lost, READY._replace(hazard=Reason.POSITION_LOST, detail="nobody"))
    assert (now.reason, now.detail) == (Reason.POSITION_LOST, "nobody")
    assert step(now, READY._replace(hazard=Reason.POSITION_LOST)).detail == "nobody"
    assert step(now, READY._replace(hazard=Reason.E_STOP)).reason is Reason.E_STOP


def test_lost_positions_that_turn_out_late_are_called_so_and_change_nothing():
    lost = step(SafetyState(OperatingState.CONTACT), READY._replace(hazard=Reason.POSITION_LOST))
    late = step(lost, READY._replace(danger=Reason.LATE))
    assert (late.state, late.reason) == (OperatingState.FAULT, Reason.LATE)
    assert task_of(late, 0) is Task.OFF


def test_positions_two_cycles_old_control_three_hold_and_twenty_one_let_go():
    now = SafetyState(OperatingState.CONTACT)
    assert [task_of(step(now, READY._replace(position_age=age)), age) for age in (0, 1, 2)] == [Task.CONTROL] * 3
    old = step(now, READY._replace(position_age=3, detail="J4"))
    assert (old.state, old.reason, old.detail) == (OperatingState.FAULT, Reason.POSITION_OLD, "J4")
    assert [task_of(old, age) for age in (3, 20, 21)] == [Task.GRAVITY] * 2 + [Task.OFF]
    assert step(old, READY).state is OperatingState.FAULT


def test_the_gravest_decides():
    seen = READY._replace(
        hazard=Reason.PUCK_FAULT, position_age=30, danger=Reason.WORKSPACE, doubt=Reason.FORCE, finish=Reason.FINISHED
    )
    reasons = []
    for key, value in (("hazard", NONE), ("position_age", 0), ("danger", NONE), ("doubt", NONE), ("finish", NONE)):
        reasons.append(step(SafetyState(OperatingState.CONTACT), seen).reason)
        seen = seen._replace(**{key: value})
    assert reasons == [
        Reason.PUCK_FAULT,
        Reason.POSITION_LOST,
        Reason.WORKSPACE,
        Reason.FORCE,
        Reason.FINISHED,
    ]


def test_doubt_retracts_and_keeps_its_reason():
    now = step(SafetyState(OperatingState.CONTACT), READY._replace(doubt=Reason.FORCE_STUCK))
    assert (now.state, now.reason) == (OperatingState.RETRACT, Reason.FORCE_STUCK)
    now = walk(READY._replace(doubt=Reason.FORCE_LOST), READY._replace(travelled=True), start=now)
    assert (now.state, now.reason) == (OperatingState.STOPPED, Reason.FORCE_STUCK)


def test_a_fault_that_holds_may_still_become_one_that_lets_go():
    now = step(SafetyState(OperatingState.CONTACT), READY._replace(danger=Reason.JOINT_RANGE))
    assert task_of(now, 0) is Task.GRAVITY
    now = step(now, READY._replace(hazard=Reason.E_STOP))
    assert now.reason is Reason.E_STOP
    assert task_of(now, 0) is Task.OFF


@pytest.mark.parametrize(
    "seen",
    [
        {"danger": Reason.JOINT_VELOCITY},
        {"danger": Reason.TIP_VELOCITY},
        {"danger": Reason.ELBOW_VELOCITY},
        {"danger": Reason.WORKSPACE},
        {"danger": Reason.LATE},
        {"position_age": BRIDGED + 1},
    ],
)
def test_who_was_too_fast_late_or_blind_brakes_and_withdraws_while_positions_are_fresh(seen):
    now = step(SafetyState(OperatingState.CONTACT), READY._replace(**seen))
    assert now.state is OperatingState.FAULT
    assert [task_of(now, age) for age in (0, 2, 3, 20, 21)] == [Task.RETRACT] * 2 + [Task.GRAVITY] * 2 + [Task.OFF]
    assert task_of(step(now, READY._replace(hazard=Reason.E_STOP)), 0) is Task.OFF


@pytest.mark.parametrize("seen", [{"danger": Reason.LATE}, {"position_age": BRIDGED + 1}, {"danger": Reason.WORKSPACE}])
def test_an_arm_that_never_approached_has_nothing_to_withdraw_from(seen):
    now = step(SafetyState(OperatingState.ARMED), READY._replace(**seen))
    assert (now.state, task_of(now, 0)) == (OperatingState.FAULT, Task.GRAVITY)
    now = walk(READY, READY, start=step(SafetyState(OperatingState.ARMED), READY._replace(doubt=Reason.LATE)))
    assert (now.state, now.reason, task_of(now, 0)) == (OperatingState.STOPPED, Reason.LATE, Task.HOLD)


def test_every_other_reason_lets_the_arm_go():
    hold = {
        *(Reason.NONE, Reason.POSITION_OLD, Reason.POSTURE, Reason.JOINT_RANGE, Reason.JOINT_VELOCITY),
        *(Reason.TIP_VELOCITY, Reason.ELBOW_VELOCITY, Reason.WORKSPACE, Reason.SINGULARITY),
        *(Reason.ENCODER_JUMP, Reason.ENCODER_STUCK, Reason.ENCODER_RANGE),
        *(Reason.TARE, Reason.FORCE, Reason.FORCE_LOST, Reason.FORCE_NOT_FINITE, Reason.FORCE_RANGE),
        *(Reason.FORCE_JUMP, Reason.FORCE_STUCK, Reason.FORCE_SLOW, Reason.FORCE_MODEL, Reason.LATE),
        *(Reason.NOT_STARTED, Reason.NO_CONTACT, Reason.OVERSHOOT, Reason.OPERATOR, Reason.FINISHED),
    }
    assert {reason for reason in Reason if not reason.lets_go} == hold


def test_every_reason_has_its_sentence():
    assert set(EXPLANATION) == set(Reason)
