"""What a cycle makes of its measurements, of time that was lost and of a refusal: no twin, one arm that stands."""

import math
from dataclasses import replace

import pytest

from deploy.bus.bus import Bus
from deploy.controller.runtimes import arm_runtime
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.loop import cycle
from deploy.loop.control import Contacting, TaskController
from deploy.loop.cycle import ASTRAY, SETTLED, ZERO, Cycle, OperatorCommand
from deploy.loop.hazards import CycleTiming
from deploy.reference.sources import ConstantForce
from deploy.safety.checker import Strictness
from deploy.safety.machine import BRIDGED, OperatingState, SafetyState, Task
from deploy.safety.overshoot import Pushes
from deploy.safety.reasons import Reason
from deploy.wam.arm import WamArm
from deploy.wam.pucks import PuckInfo, Pucks
from deploy.wam.reading import Reading
from deploy.wam.tip_pose import tip_kinematics
from tests.deploy.made import POSTURE, T_S, TOOL
from tests.deploy.wire import PENDANT, Wire

GO, PUNCTUAL = OperatorCommand(True, True), CycleTiming()


class Standing:
    """A cycle on an arm that stands, in a state from which a test begins."""

    def __init__(self, artifact, runtime, state, posture, turns, version):
        wire, pucks = Wire(), Pucks(tuple(PuckInfo(n, n, version, 0, 4096, 2700, 4860) for n in (1, 2, 3, 4)))
        self.counts = pucks.counts(posture)
        arm = WamArm(Bus(wire, wire.now), pucks, Mounted(CanSensor()), self.counts, 197)
        controller = TaskController(runtime, ConstantForce((0.0, 0.0, -5.0)), T_S, Contacting())
        model = artifact.arm
        self.cycle = Cycle(arm, controller, model.limits, T_S, TOOL, tip_kinematics(model.chain), turns)
        self.cycle.safety_state = SafetyState(state)

    def __call__(self, force=(0.0, 0.0, 0.0), counts=None, age=(0, 0, 0, 0), timing=PUNCTUAL, command=GO):
        counts = self.counts if counts is None else counts
        reading = Reading(tuple(counts), age, force, 0, 0, 2, PENDANT, 3, (2,) * 4, (2,) * 4, ())
        return self.cycle.step(reading, timing, command)

    def moved(self, motor, by):
        return [each + by * (i == motor) for i, each in enumerate(self.counts)]


@pytest.fixture(scope="module")
def runtime(arm_artifact):
    """The law, recorded once: a cycle has it forget everything."""
    return arm_runtime(arm_artifact)


@pytest.fixture
def standing(arm_artifact, runtime):
    def stand(state=OperatingState.APPROACH, posture=POSTURE, turns=False, version=150):
        return Standing(arm_artifact, runtime, state, posture, turns, version)

    return stand


@pytest.mark.parametrize(("version", "number"), [(40, 10), (50, 9), (61, 42), (150, 42)])
def test_torques_are_driven_by_the_number_that_the_pucks_know_them_by(standing, version, number):
    result = standing(version=version)()
    assert ends(result) == (OperatingState.APPROACH, Reason.NONE)
    assert result.frame.data[0] == 0x80 | number
    assert any(result.applied)


def ends(result):
    return result.safety_state.state, result.safety_state.reason


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, -1, 1)])
def test_a_force_beyond_its_limit_ends_the_approach_whatever_its_direction(standing, direction):
    size = math.hypot(*direction)

    def force(newtons):
        return tuple(newtons * each / size for each in direction)

    limit = standing().cycle.limits.force
    assert ends(standing()(force(limit - 1e-9))) == (OperatingState.APPROACH, Reason.NONE)
    assert ends(standing()(force(limit + 1e-9))) == (OperatingState.RETRACT, Reason.FORCE)


@pytest.mark.parametrize("turns", [False, True])
def test_a_force_far_from_the_wanted_one_ends_contact(standing, turns):
    """A wanted force begins at the measured one; that of a sensor that turns is turned before they are compared."""
    made = standing(OperatingState.CONTACT, turns=turns)
    raw = (0.0, 0.0, -1.0)
    first = made(raw)
    assert first.force == (first.kinematics.turned(raw) if turns else raw)
    assert made.cycle.controller.force_ref == pytest.approx(first.force, abs=0.01)
    away = (0.0, 0.6, -1.0), (0.0, 1.2, -1.0), (0.0, 1.8, -1.0)
    assert [ends(made(force)) for force in away] == [(OperatingState.CONTACT, Reason.NONE)] * 3
    assert ends(made((0.0, ASTRAY + 0.1, -1.0))) == (OperatingState.RETRACT, Reason.FORCE_MODEL)


@pytest.mark.parametrize("state", [OperatingState.CONTACT, OperatingState.RETRACT])
@pytest.mark.parametrize("by", [Reason.FINISHED, Reason.OPERATOR])
def test_whoever_ends_a_run_is_told_of_a_push_much_beyond_the_wanted_one(standing, state, by):
    def ended(measured, since=2.0):
        made = standing(OperatingState.CONTACT)
        made((0.0, 0.0, -1.0))
        made.cycle.controller._samples = round(since / T_S)
        made.cycle.safety_state = SafetyState(state, by if state is OperatingState.RETRACT else Reason.NONE)
        made.cycle.pushes = Pushes(5.0, measured)
        result = made((0.0, 0.0, -1.0), command=GO._replace(finish=by))
        return ends(result)

    assert ended(5.99) == (OperatingState.RETRACT, by)
    assert ended(6.01) == (OperatingState.RETRACT, Reason.OVERSHOOT)
    # On stiff tissue a contact that is being made reads 0.66 N more than is wanted yet.
    assert ended(6.01, since=SETTLED) == (OperatingState.RETRACT, by if by is Reason.OPERATOR else Reason.OVERSHOOT)


def test_what_was_found_to_lie_is_not_made_good_by_torque(standing):
    made = standing(OperatingState.CONTACT)
    asked, torque = [], made.cycle.controller.torque
    made.cycle.controller.torque = lambda task, *rest: (asked.append((task, rest[4])), torque(task, *rest))[1]
    for y in (0.0, 0.6, 1.2, 1.8, 2.1):
        made((0.0, y, -1.0))
    assert asked == [(Task.CONTROL, (0.0, y, -1.0)) for y in (0.0, 0.6, 1.2, 1.8)] + [(Task.RETRACT, None)]
    # Nor whatever comes after it.
    assert ends(made((0.0, 2.1, -1.0), timing=CycleTiming(missed=BRIDGED + 1))) == (OperatingState.FAULT, Reason.LATE)
    assert asked[-1] == (Task.RETRACT, None)


@pytest.mark.parametrize("motor", range(4))
def test_an_encoder_that_leaps_is_a_danger_and_its_angle_is_not_used(standing, motor):
    made = standing()
    q = made().q
    leapt = made(counts=made.moved(motor, 300))
    assert ends(leapt) == (OperatingState.FAULT, Reason.ENCODER_JUMP)
    assert leapt.q == q


def test_an_encoder_that_goes_on_leaping_lets_go_and_stays_the_reason(standing):
    """Its positions are not believed, and so grow old; but no cable and no lost frame is to be looked for."""
    made = standing()
    made()
    seen = [made(counts=made.moved(1, 300)) for _ in range(25)]
    assert [ends(each) for each in seen] == [(OperatingState.FAULT, Reason.ENCODER_JUMP)] * 25
    assert [each.safety_state.let_go for each in seen] == [False] * 20 + [True] * 5
    assert [each.task for each in seen] == [Task.GRAVITY] * 20 + [Task.OFF] * 5
    assert seen[-1].safety_state.detail == "J2 and J3 (motor 2)"


@pytest.mark.parametrize("joint", range(4))
def test_an_angle_beyond_its_stop_is_a_danger(standing, joint):
    beyond = (2.75, 2.15, 2.95, 3.3)
    made = standing(posture=tuple(beyond[i] if i == joint else each for i, each in enumerate(POSTURE)))
    result = made()
    assert ends(result) == (OperatingState.FAULT, Reason.ENCODER_RANGE)
    assert result.safety_state.detail.startswith("J")


def test_over_missed_cycles_a_motor_may_have_moved_farther(standing):
    made = standing(OperatingState.ARMED)
    made(command=GO._replace(start=False))
    result = made(counts=made.moved(0, 200), timing=CycleTiming(missed=BRIDGED), command=GO._replace(start=False))
    assert ends(result) == (OperatingState.ARMED, Reason.NONE)
    assert ends(made(counts=made.moved(0, 400)))[1] is Reason.ENCODER_JUMP


@pytest.mark.parametrize(
    ("timing", "age", "found"),
    [
        (CycleTiming(missed=BRIDGED), 0, (OperatingState.APPROACH, Reason.NONE)),
        (CycleTiming(missed=BRIDGED + 1), 0, (OperatingState.FAULT, Reason.LATE)),
        (CycleTiming(missed=1), 1, (OperatingState.APPROACH, Reason.NONE)),
        (CycleTiming(missed=2), 1, (OperatingState.FAULT, Reason.LATE)),
        (CycleTiming(), BRIDGED + 1, (OperatingState.FAULT, Reason.POSITION_OLD)),
        (CycleTiming(late=True), 0, (OperatingState.RETRACT, Reason.LATE)),
    ],
)
def test_cycles_that_were_missed_count_as_age(standing, timing, age, found):
    made = standing()
    made()
    assert ends(made(timing=timing, age=(0, 0, 0, age))) == found


@pytest.mark.parametrize("refusal", [reason for reason in Reason if reason is not Reason.NONE])
def test_a_refusal_is_taken_by_the_machine_within_the_cycle(standing, refusal):
    made = standing()
    refusals, check = [refusal], made.cycle.checker.check
    made.cycle.checker.check = lambda *asked: refusals.pop() if refusals else check(*asked)
    result = made()
    assert ends(result) == (OperatingState.FAULT, refusal)
    assert (result.task is Task.OFF) == refusal.lets_go
    assert any(result.applied) != refusal.lets_go


@pytest.mark.parametrize(
    ("state", "strictness"),
    [
        (OperatingState.IDLE, Strictness.OFF),
        (OperatingState.ARMED, Strictness.SAFE),
        (OperatingState.APPROACH, Strictness.CONTROL),
        (OperatingState.CONTACT, Strictness.CONTROL),
        (OperatingState.RETRACT, Strictness.SAFE),
        (OperatingState.STOPPED, Strictness.SAFE),
        (OperatingState.FAULT, Strictness.SAFE),
    ],
)
def test_where_the_law_or_the_approach_drives_everything_is_checked(standing, state, strictness):
    made = standing(state)
    asked, check = [], made.cycle.checker.check
    made.cycle.checker.check = lambda *arguments: (asked.append(arguments[1:3]), check(*arguments))[1]
    made(command=OperatorCommand())
    assert asked == [(strictness is not Strictness.OFF, strictness)]


def test_the_law_is_told_what_the_clamp_left_of_its_torque(standing, runtime, monkeypatch):
    made = standing(OperatingState.CONTACT)
    made.cycle.controller.torque = lambda *asked: (30.0, 0.0, 0.0, 0.0)
    told = []
    monkeypatch.setattr(runtime, "applied", told.append)
    result = made()
    assert result.clamp.rate
    assert told == [result.applied]
    assert result.applied != result.wanted


def test_who_lets_go_does_so_at_once_and_not_as_fast_as_torques_may_change(standing):
    made = standing(OperatingState.ARMED)
    made.cycle.controller.torque = lambda task, *rest: ZERO if task is Task.OFF else (30.0, 0.0, 0.0, 0.0)
    for _ in range(5):
        driven = made(command=GO._replace(start=False))
    assert driven.applied[0] > 15.0
    let_go = made(command=GO._replace(abort=True))
    assert (let_go.task, let_go.applied) == (Task.OFF, ZERO)
    assert let_go.frame == made.cycle.arm.torque_frame(ZERO)


def test_of_old_positions_no_velocity_is_made(standing):
    made = standing(OperatingState.ARMED)
    made(command=GO._replace(start=False))
    assert made(counts=made.moved(0, 20), command=GO._replace(start=False)).qd[0] != 0.0
    assert made(counts=made.moved(0, 40), age=(BRIDGED + 1, 0, 0, 0), command=GO._replace(start=False)).qd == ZERO


@pytest.mark.parametrize("turns", [False, True])
def test_the_observers_judge_the_sensor_in_contact_that_has_settled(standing, runtime, monkeypatch, turns):
    """By the force of this sample, in the world's axes, less what they expected of it at the last."""
    told, judge = [], cycle.force_step
    monkeypatch.setattr(cycle, "force_step", lambda *asked: (told.append(asked[2]), judge(*asked))[1])
    made = standing(OperatingState.CONTACT, turns=turns)
    made((0.0, 0.0, -1.0))
    for since, state in (
        (SETTLED, OperatingState.CONTACT),
        (SETTLED + T_S, OperatingState.CONTACT),
        (SETTLED + T_S, OperatingState.RETRACT),
    ):
        made.cycle.controller._samples = round(since / T_S)
        made.cycle.safety_state = SafetyState(state)
        expected, found = runtime.prediction, made((0.1, 0.2, -1.1)).force
        if since > SETTLED and state is OperatingState.CONTACT:
            innovation = [one - other for one, other in zip(found, expected, strict=True)]
    assert told == [None, None, pytest.approx(innovation, abs=1e-12), None]
    assert min(map(abs, innovation)) > 1e-3
    assert min(map(abs, expected)) > 1e-3


def test_the_sine_is_asked_of_the_tip_too(standing, runtime, monkeypatch):
    monkeypatch.setattr(type(runtime), "dither", (0.0, 0.0, -0.3))
    made = standing(OperatingState.CONTACT)
    for _ in range(2):
        made((0.0, 0.0, -1.5))
    assert made.cycle.pushes.wanted == pytest.approx(1.8, abs=0.02)


@pytest.mark.parametrize("state", [OperatingState.CONTACT, OperatingState.RETRACT])
def test_pushes_count_in_contact_and_on_the_way_out(standing, state):
    made = standing(state)
    made((0.0, 0.0, -1.5))
    assert made.cycle.pushes.measured == pytest.approx(1.5)
    before = standing(OperatingState.APPROACH)
    before((0.0, 0.0, -1.5))
    assert before.cycle.pushes.measured == 0.0


DRIVEN = {
    OperatingState.ARMED: Task.HOLD,
    OperatingState.APPROACH: Task.APPROACH,
    OperatingState.CONTACT: Task.CONTROL,
    OperatingState.RETRACT: Task.RETRACT,
    OperatingState.STOPPED: Task.HOLD,
}


@pytest.mark.parametrize(
    ("state", "reason", "speed", "ended", "detail", "softened"),
    [
        (OperatingState.ARMED, Reason.NONE, 0.71, Reason.NONE, "", 0),  # somebody may have pushed
        (OperatingState.APPROACH, Reason.NONE, 0.71, Reason.JOINT_VELOCITY, "J3 swings", 1),
        (OperatingState.CONTACT, Reason.NONE, 0.71, Reason.JOINT_VELOCITY, "", 0),  # the checker's, at once
        (OperatingState.RETRACT, Reason.FINISHED, 0.71, Reason.JOINT_VELOCITY, "J3 swings", 1),
        (OperatingState.STOPPED, Reason.OPERATOR, 0.71, Reason.JOINT_VELOCITY, "J3", 0),
        (OperatingState.RETRACT, Reason.FORCE, 0.71, Reason.FORCE, "", 1),
        (OperatingState.STOPPED, Reason.OVERSHOOT, 0.71, Reason.OVERSHOOT, "", 0),
        (OperatingState.RETRACT, Reason.FINISHED, 0.51, Reason.JOINT_VELOCITY, "J3", 0),
        (OperatingState.STOPPED, Reason.FORCE, 0.51, Reason.FORCE, "", 0),
        (OperatingState.RETRACT, Reason.FINISHED, 0.49, Reason.FINISHED, "", 0),
    ],
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_swing_softens_the_servo_and_a_limit_that_is_less_ends_what_was_to_go_well(
    standing, runtime, monkeypatch, state, reason, speed, ended, detail, softened, sign
):
    made, softer = standing(), []
    made.cycle.limits = replace(made.cycle.limits, joint_velocity=(0.6, 0.6, 0.5, 0.6))
    made.cycle.checker.limits = made.cycle.limits
    monkeypatch.setattr(made.cycle.controller, "soften", lambda: softer.append(made))
    for i in range(104):
        made.cycle.safety_state, made.cycle._task = SafetyState(state, reason), DRIVEN[state]
        monkeypatch.setattr(runtime, "velocity", lambda q, v=sign * speed * (i > 100): (0.1, 0.0, v, 0.0))
        result = made((0.0, 0.0, -0.01 * (i % 7)), command=GO._replace(start=False))
    assert (result.safety_state.reason, result.safety_state.detail, len(softer)) == (ended, detail, softened)


@pytest.mark.parametrize(
    ("state", "reason"), [(OperatingState.ARMED, Reason.NONE), (OperatingState.STOPPED, Reason.FINISHED)]
)
def test_a_swing_both_ways_softens_the_servo_that_holds(standing, runtime, monkeypatch, state, reason):
    made, softer = standing(), []
    monkeypatch.setattr(made.cycle.controller, "soften", lambda: softer.append(made))
    for i in range(108):
        made.cycle.safety_state, made.cycle._task = SafetyState(state, reason), Task.HOLD
        monkeypatch.setattr(runtime, "velocity", lambda q, v=0.71 * ((i > 104) - (100 < i < 104)): (0.0, 0.0, v, 0.0))
        result = made((0.0, 0.0, -0.01 * (i % 7)), command=GO._replace(start=False))
    assert (result.safety_state.reason, result.safety_state.detail) == (Reason.JOINT_VELOCITY, "J3 swings")
    assert len(softer) == 1


@pytest.mark.parametrize(("driven", "found"), [(True, Reason.JOINT_VELOCITY), (False, Reason.NONE)])
def test_a_swing_far_below_the_limits_ends_the_run_of_an_arm_that_is_driven(
    standing, runtime, monkeypatch, driven, found
):
    made = standing(OperatingState.APPROACH)
    monkeypatch.setattr(type(made.cycle._hazards), "active", driven)
    monkeypatch.setattr(runtime, "velocity", lambda q: (0.0, 0.0, 0.71, 0.0))
    for i in range(104):
        result = made((0.0, 0.0, -0.01 * (i % 7)), command=GO._replace(start=False))
    assert result.safety_state.reason is found


def test_a_hazard_in_the_cycle_of_a_swing_keeps_its_own_detail(standing, runtime, monkeypatch):
    made = standing(OperatingState.ARMED)
    monkeypatch.setattr(cycle, "swing_step", lambda state, *rest, **named: (state, True))
    monkeypatch.setattr(made.cycle._hazards, "judge", lambda *asked: (Reason.PUCK_FAULT, "puck 2 reports STAT 0"))
    assert made(command=GO._replace(start=False)).safety_state.detail == "puck 2 reports STAT 0"
