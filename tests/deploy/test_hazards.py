"""What forbids to drive the arm, cycle by cycle: of bus, pendant, safety module, pucks and clock."""

from types import SimpleNamespace

import pytest

from deploy.bus.bus import Counters
from deploy.loop.hazards import (
    CHANGING,
    NOBODY,
    CycleTiming,
    Hazards,
)
from deploy.safety.machine import BRIDGED
from deploy.safety.reasons import Reason
from deploy.wam.reading import Reading
from tests.deploy.wire import PENDANT, START

T_S = 1e-3
FOREIGN, LATELY, SILENT, UNANSWERED = 4, 1000, 100, 25
"""Frames, and cycles, at 1 kHz."""
FINE = Reading(START, (0,) * 4, (0.0, 0.0, -5.0), 0, 0, 2, PENDANT, 3, (2,) * 4, (2,) * 4, ())
NONE, PUNCTUAL = (Reason.NONE, ""), CycleTiming()


class Judge:
    """Hazards of an arm in its thousands of cycles, of whose bus a test says what it likes."""

    def __init__(self, T_s=T_S):
        bus = SimpleNamespace(state="active", remedy="a remedy", counters=Counters())
        self.arm = SimpleNamespace(bus=bus, late=0, cycle=5000, pucks=SimpleNamespace(nodes=(1, 2, 3, 4)))
        self.hazards = Hazards(self.arm, T_s)

    def __call__(self, timing=PUNCTUAL, youngest=0, **changed):
        self.arm.cycle += 1
        return self.hazards.judge(FINE._replace(**changed), timing, youngest)


@pytest.fixture
def judge():
    return Judge()


def test_a_healthy_arm_is_driven(judge):
    assert {judge() for _ in range(1000)} == {NONE}
    assert judge.hazards.active


def test_an_e_stop_is_one_in_the_first_cycle_and_in_any(judge):
    assert judge(safety_mode=0) == (Reason.E_STOP, "")
    assert judge() == NONE
    assert judge(safety_mode=0) == (Reason.E_STOP, "")


def test_idle_is_none_before_the_activation_and_a_hazard_after_it(judge):
    for mode in (None, 1):
        assert judge(safety_mode=mode) == NONE
        assert not judge.hazards.active
    assert judge() == NONE
    assert judge.hazards.active
    assert judge(safety_mode=1) == (Reason.IDLE, "")
    assert not judge.hazards.active


def test_a_safety_module_that_falls_silent(judge):
    assert judge(safety_age=SILENT) == NONE
    assert judge(safety_age=SILENT + 1) == (Reason.PENDANT_FAULT, "the safety module is silent")
    judge.arm.cycle = SILENT - 1
    assert judge(safety_age=1_000_000) == NONE  # it has hardly been asked
    assert judge(safety_age=1_000_000)[0] is Reason.PENDANT_FAULT


def test_faults_on_the_pendant_are_named(judge):
    assert judge(pendant=None) == NONE
    assert judge(pendant=PENDANT._replace(torque="WARNING")) == NONE
    shown = PENDANT._replace(torque="FAULT", heartbeat="FAULT")
    assert judge(pendant=shown) == (Reason.PENDANT_FAULT, "torque, heartbeat")


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("status", [0, 1, 3])
def test_every_puck_must_be_ready(judge, motor, status):
    told = tuple(status if i == motor else 2 for i in range(4))
    assert judge(puck_status=told) == (Reason.PUCK_FAULT, f"puck {motor + 1} reports STAT {status}")


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("mode", [None, 0, 3])
def test_every_puck_must_soon_be_in_its_torque_mode_and_stay_there(judge, motor, mode):
    told = tuple(mode if i == motor else 2 for i in range(4))
    assert {judge(puck_mode=told) for _ in range(round(CHANGING / T_S))} == {NONE}
    assert judge(puck_mode=told) == (Reason.PUCK_FAULT, f"puck {motor + 1} left its torque mode")
    judge(safety_mode=1)
    assert judge(puck_mode=told, safety_mode=1) == NONE  # nobody has activated it


def test_foreign_frames_count_where_they_are_many_twice_in_a_row(judge):
    def with_foreign(frames):
        judge.arm.bus.counters.foreign += frames
        return judge()

    few, many = FOREIGN - 1, FOREIGN
    assert [with_foreign(frames) for frames in (few, few, few, many, few, many, few)] == [NONE] * 7
    assert with_foreign(many) == NONE
    assert with_foreign(many) == (Reason.BUS_LOAD, "frames of a stranger fill the bus")


def test_a_single_frame_of_another_host_is_one_too_many(judge):
    judge.arm.bus.counters.hosts += 1
    assert judge() == (Reason.BUS_LOAD, "another host sends on this bus")


@pytest.mark.parametrize(
    ("state", "found"),
    [
        ("down", (Reason.BUS_OFF, "a remedy")),
        ("off", (Reason.BUS_OFF, "")),
        ("error", (Reason.BUS_ERROR, "")),
    ],
)
def test_a_bus_that_cannot_be_relied_on(judge, state, found):
    judge.arm.bus.state = state
    assert judge() == found


def test_where_no_puck_answers_the_arm_is_lost_and_it_is_told_who_else_is_silent(judge):
    assert judge(youngest=BRIDGED - 1) == NONE
    assert judge(youngest=BRIDGED) == (Reason.POSITION_LOST, "no puck answers, as after an e-stop")
    silent = {"safety_age": UNANSWERED + 1, "force_age": BRIDGED}
    assert judge(youngest=BRIDGED, **silent) == (Reason.POSITION_LOST, NOBODY)
    for other in ({"safety_age": UNANSWERED}, {"force_age": BRIDGED - 1}):
        assert judge(youngest=BRIDGED, **(silent | other))[1] != NOBODY


@pytest.mark.parametrize("how", ["missed", "late", "replies"])
def test_for_a_second_after_anything_late_what_does_not_come_is_late_and_not_lost(judge, how):
    if how == "replies":
        judge.arm.late += 1
    assert judge(CycleTiming(missed=int(how == "missed"), late=how == "late"), BRIDGED) == NONE
    assert judge.hazards.lately
    judge.arm.cycle += LATELY - 2
    assert judge(youngest=BRIDGED) == NONE
    assert judge(youngest=BRIDGED)[0] is Reason.POSITION_LOST
    assert not judge.hazards.lately


@pytest.mark.parametrize("motor", range(4))
def test_a_puck_that_has_not_told_its_state_for_half_a_second(judge, motor):
    def ages(age):
        return tuple(age if i == motor else 0 for i in range(4))

    assert judge(puck_age=ages(500)) == NONE
    assert judge(puck_age=ages(501)) == (Reason.PUCK_FAULT, f"puck {motor + 1} does not tell its state")


@pytest.mark.parametrize("reason", [Reason.STALLED, Reason.WATCHDOG])
def test_the_clock_and_the_watchdog_have_the_first_word(judge, reason):
    judge.arm.bus.state = "off"
    assert judge(CycleTiming(hazard=reason), safety_mode=0) == (reason, "")
