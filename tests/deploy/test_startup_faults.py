"""What is wrong with an arm is said before it moves, with what to check."""

import can
import pytest

from deploy.errors import BusError, CalibrationError
from deploy.puck.frame import Frame
from tests.deploy.fake_arm import KINDS, PENDANT, FakeArm, start
from tests.deploy.pendants import encode_pendant


def values(node, **changes):
    def change(fake):
        fake.values[node].update(changes)

    return change


def silent(*nodes):
    return lambda fake: fake.silent.update(nodes)


def pendant(**changes):
    return values(10, PEN=encode_pendant(PENDANT._replace(**changes)))


def seven(fake):
    fake.versions[5] = 150
    KINDS[5] = "motor"
    fake.values[5] = {"STAT": 2, "VERS": 150}


def other_host(fake):
    fake.queue.append(Frame(0x401, bytes(8)))


def will_not_wake(fake):
    fake.deaf.add((2, "STAT"))


def will_not_zero(fake):
    fake.values[10]["ZERO"] = 0
    fake.deaf.add((10, "ZERO"))


def will_not_move(fake):
    fake.values[10]["ZERO"] = 0
    fake.values[3]["P"] = 0
    fake.deaf.add((3, "P"))


@pytest.mark.parametrize(
    ("fault", "error", "says"),
    [
        (silent(1, 2, 3, 4, 8, 10), BusError, "nobody answers on this bus: .*1 Mbit/s"),
        (silent(3), BusError, "puck 3 does not answer: check its light"),
        (silent(8), BusError, "the force sensor does not answer"),
        (silent(10), BusError, "the safety module does not answer"),
        (values(10, ROLE=0), BusError, "no safety module"),
        (values(10, MODE=0), BusError, "in e-stop: release the e-stop and press Shift-idle"),
        (values(10, MODE=2), BusError, "active: press Shift-idle"),
        (values(10, MODE=9), BusError, "unknown mode 9"),
        (pendant(velocity="FAULT"), BusError, "FAULT of velocity:"),
        (pendant(torque="FAULT", heartbeat="FAULT"), BusError, "FAULT of torque and heartbeat:"),
        (values(10, VL2=0), CalibrationError, "VL2 = 0"),
        (values(2, STAT=1), BusError, r"puck 2 reports an error \(STAT 1\)"),
        (will_not_wake, BusError, r"puck 2 does not wake \(STAT 0\)"),
        (values(4, ROLE=5), CalibrationError, "puck 4 is no motor puck but says hand"),
        (values(1, IPNM=0), CalibrationError, "puck 1 says IPNM 0"),
        (values(1, CTS=0), CalibrationError, "puck 1 says CTS 0"),
        (values(2, MT=0), CalibrationError, "puck 2 says MT 0"),
        (values(2, PIDX=1), CalibrationError, "places in a torque are not 1 to 4"),
        (values(2, GRPB=2), CalibrationError, "torques of group 2, not 1"),
        (values(2, P=2**20), CalibrationError, r"joint 2 says .*beyond its stops"),
        (seven, BusError, "7 joints"),
        (other_host, BusError, "somebody else commands on this bus"),
        (will_not_zero, CalibrationError, "home position was not taken"),
        (will_not_move, CalibrationError, "home position was not taken"),
    ],
)
def test_every_failure_says_what_to_check(fault, error, says):
    fake = FakeArm()
    fault(fake)
    with pytest.raises(error, match=says) as raised:
        start(fake, home=True)
    KINDS.pop(5, None)
    assert "\n" not in str(raised.value)
    assert fake.told("T") == []
    assert all(value == 0 for _, _, value in fake.told("MODE"))


def test_a_bus_that_takes_nothing_is_said_so():
    fake = FakeArm()

    def send(msg, timeout=None):
        raise can.CanOperationError("full", 105)

    fake.send = send
    with pytest.raises(BusError, match=r"the bus takes no frames .*1 Mbit/s"):
        start(fake)


def test_a_puck_deaf_to_the_group_is_named():
    fake = FakeArm().awake()
    answer = fake.answer

    def answer_but_no_position(node, name, number):
        if (node, name) != (2, "P"):
            answer(node, name, number)

    fake.answer = answer_but_no_position
    with pytest.raises(BusError, match="puck 2 does not tell its position"):
        start(fake)
