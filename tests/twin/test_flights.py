"""Whole runs in lock-step against the twin: clean ones, and everything that may go wrong on the way."""

from functools import cache

import numpy as np
import pytest

from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from jaxmpc import Experiment, Params, evaluate
from jaxmpc.world.heart.motion import Motion
from jaxmpc.world.tissue import KINDS
from tests.twin.flying import fly

pytestmark = [pytest.mark.usefixtures("recorded_once"), pytest.mark.once]
BEFORE = 0.012
"""Start above the tissue: the heart rises by 8 mm [m]."""
FAULT_AT = 3.5
"""In contact since half a second or more, the force being −2 N or beyond [s]."""
SEEN_AT_ONCE = ("off", "nan", "inf", "-inf", "unit", "jump", "jump=-10")


@pytest.fixture(scope="module")
def simulated():
    """Residual RMS of the text design in the simulator, per stiffness and axis [N]."""
    outcome = evaluate(Params.published("text"), Experiment.published("table-1-wam"))
    return dict(zip((375.0, 810.0, 1900.0), np.asarray(outcome.metrics.rms), strict=True))


@pytest.mark.oracle
@pytest.mark.parametrize("stiffness", [375.0, pytest.param(810.0, marks=pytest.mark.slow), 1900.0])
def test_table_1_is_that_of_the_simulator(text, simulated, stiffness):
    # As in the simulator the heart begins to move once the tip is on it.
    flight = fly(text, stiffness=stiffness, seconds=25.0, motion=Motion(start=3.5), gap=BEFORE)
    assert flight.reason is Reason.FINISHED
    assert flight.contact < 3.5
    np.testing.assert_allclose(flight.residual(5.0), simulated[stiffness], rtol=0.05)
    assert flight.clamped < 0.001 * flight.ended.contact_cycles


@pytest.mark.parametrize(
    ("fault", "reason", "detail"),
    [
        ("pendant:e-stop", {Reason.E_STOP, Reason.POSITION_LOST}, ""),
        ("pendant:idle", {Reason.IDLE}, ""),
        ("puck3:fault", {Reason.PUCK_FAULT}, "puck 3"),
        ("bus:off", {Reason.BUS_OFF, Reason.BUS_ERROR}, ""),
        ("bus:babble=8000", {Reason.BUS_LOAD}, "stranger"),
    ],
)
@pytest.mark.parametrize("phase", [pytest.param(0.0, marks=pytest.mark.oracle), 0.003])
def test_a_hazard_ends_torque_within_two_cycles_for_good(plain, fault, reason, detail, phase):
    at = 2.5 + phase
    flight = fly(plain, f"{fault}@{at}+1.0" if fault.startswith("bus") else f"{fault}@{at}", "pendant:activate@2.7",
                 seconds=4.0, motion=Motion(start=9.0), gap=BEFORE)  # fmt: skip
    assert flight.ended.safety_state.state is OperatingState.FAULT
    assert flight.reason in reason
    assert detail in flight.ended.safety_state.detail
    driven = [time for time, units in flight.frames if time >= at and any(units)]
    assert len(driven) <= 2
    assert all(time < at + 2e-3 for time in driven)
    assert flight.twin.safety.mode != 2 or fault.startswith("bus:off")


@pytest.mark.usefixtures("held_briefly")
@pytest.mark.oracle
def test_a_lost_reply_now_and_then_is_bridged(text):
    lossy = fly(text, "positions:lost=0.001", seconds=12.0, motion=Motion(start=2.5), gap=BEFORE, seed=3)
    clean = fly(text, seconds=12.0, motion=Motion(start=2.5), gap=BEFORE, seed=3)
    assert lossy.reason is clean.reason is Reason.FINISHED
    assert lossy.twin.counters["lost"] > 20
    np.testing.assert_allclose(lossy.residual(5.0), clean.residual(5.0), rtol=0.05)


@pytest.mark.oracle
def test_two_lost_replies_in_a_row_are_bridged_and_three_are_not(plain):
    bridged = fly(plain, f"J2:lost=2@{FAULT_AT}", seconds=3.0, motion=Motion(start=2.5), gap=BEFORE)
    assert bridged.reason is Reason.FINISHED
    assert bridged.twin.counters["lost"] == 2

    flight = fly(plain, f"J2:lost=3@{FAULT_AT}", seconds=4.0, motion=Motion(start=2.5), gap=BEFORE)
    assert (flight.ended.safety_state.state, flight.reason) == (OperatingState.FAULT, Reason.POSITION_OLD)
    assert "J2" in flight.ended.safety_state.detail
    assert flight.detected(FAULT_AT) == 3
    # Gravity's torque alone while J2 is silent; then it tells again, and the tip withdraws from the tissue.
    signals = flight.signals()
    blind = int(np.argmin(np.abs(flight.time - (FAULT_AT + 0.003))))
    gravity = flight.session.controller.runtime.gravity(tuple(signals["q"][blind]))
    np.testing.assert_allclose(signals["wanted"][blind], gravity, atol=1e-9)
    assert signals["tip"][-1, 2] > signals["tip"][blind, 2] + 0.025
    assert abs(flight.force[flight.force_time > FAULT_AT + 0.8]).max() < 0.01


@cache
def clean_flight(artifact, **settings):
    return fly(artifact, seconds=3.0, gap=BEFORE, **settings)


def sensor_fault(artifact, word, **settings):
    return fly(artifact, f"force:{word}@{FAULT_AT}", seconds=3.0, gap=BEFORE, **settings)


def check_sensor_fault(artifact, word, **settings):
    flight, clean = sensor_fault(artifact, word, **settings), clean_flight(artifact, **settings)
    assert clean.reason is Reason.FINISHED
    detected = flight.detected(FAULT_AT)
    assert 0 <= detected <= (11 if word == "stuck" else 3)
    assert flight.ended.safety_state.state is OperatingState.STOPPED
    assert str(flight.reason).startswith("force")
    assert flight.peak() <= clean.peak() + 0.5
    assert flight.push() <= clean.push() + 0.5


@pytest.mark.usefixtures("held_briefly")
@pytest.mark.oracle
@pytest.mark.parametrize("word", ["off", "stuck"])
def test_a_dead_or_mad_force_sensor_ends_contact_gently(cautious, word):
    check_sensor_fault(cautious, word)


@pytest.mark.slow
@pytest.mark.parametrize("tissue", KINDS)
def test_a_dead_or_mad_force_sensor_ends_contact_gently_on_every_tissue(cautious, tissue):
    for word in (*SEEN_AT_ONCE, "stuck"):
        check_sensor_fault(cautious, word, tissue=tissue)


@pytest.mark.slow
@pytest.mark.parametrize("tissue", KINDS)
@pytest.mark.parametrize("word", ["slow", "delayed", "delayed=3", "wrong", "wrong=0.5", "sign", "intermittent=0.2"])
def test_a_lying_force_sensor_stays_within_the_hard_limits(cautious, tissue, word, record_property):
    flight = sensor_fault(cautious, word, tissue=tissue)
    assert flight.peak() <= cautious.arm.limits.force
    assert flight.ended.safety_state.state in (OperatingState.STOPPED, OperatingState.FAULT)
    record_property("seen", f"{flight.reason} after {flight.detected(FAULT_AT)} cycles, {flight.peak():.2f} N")


@pytest.mark.slow
@pytest.mark.parametrize("tissue", KINDS)
@pytest.mark.parametrize(
    "rhythm",
    ["harmonics", "steady", "variability", "rate-step", "premature", "bigeminy", "fibrillation", "ventilator-hold",
     "cough", "amplitude-drift"],
)  # fmt: skip
def test_no_alarm_in_a_clean_minute(cautious, tissue, rhythm):
    flight = fly(cautious, seconds=60.0, gap=BEFORE, tissue=tissue, rhythm=rhythm, record=1.0)
    assert (flight.ended.safety_state.state, flight.reason) == (OperatingState.STOPPED, Reason.FINISHED)
    assert flight.clamped < 0.001 * flight.ended.contact_cycles


def test_no_torque_frame_ever_breaks_a_limit(cautious):
    """What the frames carried, worked out here from the puck units alone."""
    flight = fly(cautious, f"force:jump@{FAULT_AT}", seconds=3.0, gap=BEFORE)
    units = np.array([units for _, units in flight.frames])
    motors = units / 2700.0
    joints = motors @ np.array([[-42.0, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18.0]])
    limits = cautious.arm.limits
    assert (np.abs(motors) <= limits.motor_torque).all()
    assert (np.abs(joints) <= limits.joint_torque).all()
    driven = units.any(axis=1)
    both = driven[1:] & driven[:-1]  # letting go may be as sudden as it likes
    assert (np.abs(np.diff(joints, axis=0))[both] <= np.array(limits.torque_rate) * 1e-3).all()


@pytest.mark.oracle
def test_the_same_flight_twice_is_the_same(cautious):
    one, other = (fly(cautious, seconds=1.0, gap=BEFORE, seed=5) for _ in range(2))
    assert one.frames == other.frames


@pytest.mark.usefixtures("held_briefly")
def test_a_sensor_with_the_wrong_sign_from_the_start_shows_at_first_contact(cautious):
    flight = fly(cautious, "force:sign@0", stiffness=1900.0, seconds=3.0, gap=BEFORE)
    assert (flight.ended.safety_state.state, flight.reason) == (OperatingState.STOPPED, Reason.FORCE_MODEL)
    assert flight.peak() <= cautious.arm.limits.force


@pytest.mark.usefixtures("held_briefly")
@pytest.mark.oracle
def test_nothing_is_met(cautious):
    flight = fly(cautious, seconds=1.0, gap=0.08)
    assert (flight.ended.safety_state.state, flight.reason) == (OperatingState.STOPPED, Reason.NO_CONTACT)
