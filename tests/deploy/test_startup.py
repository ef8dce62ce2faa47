"""How an arm is started: what is asked and set, and that nothing moves."""

from itertools import pairwise
from math import pi

import pytest

from deploy.bus.bus import Bus
from deploy.controller.limits import MECHANICAL_STOPS
from deploy.errors import CalibrationError
from deploy.force.sensor import Mounted, Wrench
from deploy.puck.codec import decode
from deploy.puck.frame import Frame
from deploy.puck.messages import Get
from deploy.wam.homing import within_stops
from deploy.wam.startup import startup
from tests.deploy.fake_arm import HOME_COUNTS, MS, FakeArm, start


def test_an_arm_that_knows_its_place_starts_idle_and_nothing_moves():
    fake = FakeArm()
    arm, said = start(fake)
    assert arm.counts == HOME_COUNTS
    assert arm.pucks.angles(arm.counts) == pytest.approx((0.0, -2.0, 0.0, 3.13), abs=2e-3)
    assert all(fake.values[node]["MODE"] == 0 for node in (1, 2, 3, 4))
    assert fake.told("P", "ZERO", "T") == []
    assert fake.values[10]["IFAULT"] == 5
    assert [value for _, name, value in fake.told("MODE")] == [0] * 4  # never upwards, and not on the safety module
    assert any("waking puck 1, puck 2" in sentence for sentence in said)
    reading_sent = arm.request()
    assert reading_sent
    assert arm.collect(fake.ns + MS).counts == tuple(HOME_COUNTS)


def test_safety_limits_are_reset_in_peace():
    fake = FakeArm()
    start(fake)
    defaults = [(ns, name, value) for ns, node, name, value in fake.orders if name in ("DEF", "LOAD")]
    assert [(name, value) for _, name, value in defaults] == [(n, v) for v in (45, 46, 47, 48) for n in ("DEF", "LOAD")]
    assert all(b[0] - a[0] >= 10 * MS for a, b in pairwise(defaults))


def test_pucks_wake_one_by_one_and_in_silence():
    fake = FakeArm()
    heard = []
    send = fake.send
    fake.send = lambda msg, timeout=None: (heard.append((fake.ns, msg.arbitration_id)), send(msg))
    start(fake)
    wakes = [(ns, node) for ns, node, name, value in fake.orders if name == "STAT"]
    assert [node for _, node in wakes] == [1, 2, 3, 4, 8]
    assert all(b[0] - a[0] >= 10 * MS for a, b in pairwise(wakes))
    last = wakes[-1][0]
    assert not [id for ns, id in heard if last < ns < last + 1000 * MS]


def test_who_is_awake_is_left_alone():
    fake = FakeArm().awake()
    start(fake)
    assert fake.told("STAT") == []
    assert fake.ns < 1000 * MS


@pytest.mark.parametrize("zero", [0, 2, -1])
def test_without_being_told_home_is_not_set(zero):
    fake = FakeArm(zero=zero)
    with pytest.raises(CalibrationError, match=r"does not know where it is .*--home"):
        start(fake)
    assert fake.told("P", "ZERO") == []


def test_home_is_set_when_told():
    fake = FakeArm(zero=0)
    for node in (1, 2, 3, 4):
        fake.values[node]["P"] = 17
    arm, said = start(fake, home=True)
    steps = fake.told("IFAULT", "P", "ZERO")
    places = [(node, "P", HOME_COUNTS[node - 1]) for node in (1, 2, 3, 4)]
    assert steps == [(10, "IFAULT", 5), *places, (10, "ZERO", 1), (10, "IFAULT", 5)]
    assert arm.counts == HOME_COUNTS
    assert "home position set" in said


def test_home_elsewhere():
    fake = FakeArm(zero=0)
    arm, _ = start(fake, home=True, home_angles=(0.1, -1.9, 0.2, 3.0))
    assert arm.pucks.angles(arm.counts) == pytest.approx((0.1, -1.9, 0.2, 3.0), abs=2e-4)


def test_an_arm_that_knows_its_place_is_not_homed_again():
    fake = FakeArm(zero=1)
    _, said = start(fake, home=True)
    assert fake.told("P", "ZERO") == []
    assert any("not set again" in sentence for sentence in said)


def test_zero_calibration_moves_home_to_where_the_encoders_are():
    # each absolute encoder stands 40 counts beyond where the zero calibration has it
    fake = FakeArm(zero=0)
    shift = 40
    for node in (1, 2, 3, 4):
        fake.values[node]["MECH"] = (HOME_COUNTS[node - 1] + shift) % 4096
    arm, _ = start(fake, home=True, zero_angles=(0.0, 0.0, 0.0, 0.0))
    for counts, home in zip(arm.counts, HOME_COUNTS, strict=True):
        assert abs(counts - home - shift) <= 1
    fake = FakeArm(zero=0)
    fake.values[2]["ROLE"] = 0
    with pytest.raises(CalibrationError, match="puck 2 has no absolute encoder"):
        start(fake, home=True, zero_angles=(0.0, 0.0, 0.0, 0.0))


def test_zero_calibration_is_where_the_encoders_stand_at_zero():
    fake = FakeArm(zero=0)
    zero = (0.3, -0.2, 0.1, 0.4)
    for node, angle in zip((1, 2, 3, 4), zero, strict=True):
        fake.values[node]["MECH"] = round(HOME_COUNTS[node - 1] + 4096 * angle / (2.0 * pi)) % 4096
    arm, _ = start(fake, home=True, zero_angles=zero)
    assert all(abs(counts - home) <= 1 for counts, home in zip(arm.counts, HOME_COUNTS, strict=True))


def test_zero_calibration_needs_firmware_118():
    start(FakeArm(zero=0, version=118), home=True, zero_angles=(0.0,) * 4)
    with pytest.raises(CalibrationError, match="firmware before 118"):
        start(FakeArm(zero=0, version=117), home=True, zero_angles=(0.0,) * 4)


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("end", [0, 1])
def test_half_a_motor_turn_beyond_a_stop_is_what_homing_may_be_wrong_by(joint, end):
    def angles(beyond):
        at = MECHANICAL_STOPS[joint][end] + (beyond if end else -beyond)
        return tuple(at if i == joint else 0.0 for i in range(4))

    within_stops(angles(0.189))
    with pytest.raises(CalibrationError, match=f"joint {joint + 1} says"):
        within_stops(angles(0.191))


def test_a_lost_answer_is_asked_for_again():
    clean, lossy = FakeArm().awake(), FakeArm().awake()
    lossy.lose = 2
    (arm, _), (other, _) = start(clean), start(lossy)
    assert lossy.lose == 0
    assert lossy.asked == clean.asked + 2
    assert other.pucks.infos == arm.pucks.infos
    assert other.counts == arm.counts


def test_old_firmware_has_other_numbers():
    arm, _ = start(FakeArm(version=60).awake())
    assert arm.torque_frame((0.0,) * 4).data[0] == 0x80 | 9
    arm, _ = start(FakeArm(version=64).awake())
    assert arm.pucks.infos[0].counts_per_turn == 4096


def test_a_sensor_off_the_bus_asks_for_no_node():
    class Elsewhere:
        ready = True

        def request(self):
            return ()

        def feed(self, frame):
            return False

        def read(self):
            return Wrench((0.0,) * 3, (0.0,) * 3, 0)

        def tare(self):
            return ()

    fake = FakeArm()
    del fake.values[8]
    arm = startup(Bus(fake, fake.now), fake, Mounted(Elsewhere()))
    arm.request()
    assert arm.collect(fake.ns + MS).force == (0.0, 0.0, 0.0)


def test_the_operator_is_waited_for():
    fake = FakeArm()
    fake.values[10]["MODE"] = 0
    fake.silent = {1, 2, 3, 4}  # in e-stop the pucks have no power
    wait = fake.wait_until

    def release_after_two_seconds(deadline_ns):
        wait(deadline_ns)
        if fake.ns > 2000 * MS:
            fake.values[10]["MODE"] = 1
            fake.silent = set()

    fake.wait_until = release_after_two_seconds
    _, said = start(fake, patience_s=10.0)
    assert any("release the e-stop and press Shift-idle" in sentence for sentence in said)
    assert 2000 * MS < fake.ns < 10_000 * MS


def test_enumeration_asks_every_node_once():
    fake = FakeArm().awake()
    asked = []
    send = fake.send
    fake.send = lambda msg, timeout=None: (asked.append(Frame(msg.arbitration_id, bytes(msg.data))), send(msg))
    start(fake)
    assert [decode(frame) for frame in asked[:31]] == [Get(node, 5) for node in range(1, 32)]
