"""What is wrong with an arm is said before it moves, with what to check."""

import can
import pytest

from deploy.errors import BusError, CalibrationError
from deploy.puck.frame import Frame
from deploy.wam.dialogue import Dialogue
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


def seven(node):
    def change(fake):
        fake.versions[node] = 150
        KINDS[node] = "motor"
        fake.values[node] = {"STAT": 2, "VERS": 150}

    return change


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
        (values(10, TL2=0), CalibrationError, "TL2 = 0"),
        (values(2, STAT=1), BusError, r"puck 2 reports an error \(STAT 1\)"),
        (will_not_wake, BusError, r"puck 2 does not wake \(STAT 0\)"),
        (values(4, ROLE=5), CalibrationError, "puck 4 is no motor puck but says hand"),
        (values(1, IPNM=0), CalibrationError, "puck 1 says IPNM 0"),
        (values(1, CTS=0), CalibrationError, "puck 1 says CTS 0"),
        (values(2, MT=0), CalibrationError, "puck 2 says MT 0"),
        (values(2, PIDX=1), CalibrationError, "places in a torque are not 1 to 4"),
        (values(2, GRPB=2), CalibrationError, "torques of group 2, not 1"),
        (values(2, P=2**20), CalibrationError, r"joint 2 says .*beyond its stops"),
        (seven(5), BusError, "puck 5 answers too: this is a WAM with 7 joints"),
        (seven(7), BusError, "puck 7 answers too: this is a WAM with 7 joints"),
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
    for node in (5, 7):
        KINDS.pop(node, None)
    assert "\n" not in str(raised.value)
    assert fake.told("T") == []
    assert all(value == 0 for _, _, value in fake.told("MODE"))


def test_who_begins_to_command_while_the_arm_is_started_is_told():
    fake = FakeArm()
    answer = fake.answer

    def answer_and_command(node, name, number):
        answer(node, name, number)
        if name == "PIDX":
            other_host(fake)

    fake.answer = answer_and_command
    with pytest.raises(BusError, match="somebody else commands on this bus"):
        start(fake)


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


def test_a_puck_that_falls_silent_is_not_taken_to_stand_where_it_stood():
    fake = FakeArm().awake()
    arm, _ = start(fake)
    talk, question = Dialogue(arm.bus, fake), Frame(0x404, b"\x30")
    assert talk.told_positions(question, (1, 2, 3, 4)) == arm.counts
    fake.silent.add(3)
    assert talk.ask_positions(question, (1, 2, 3, 4)) is None
    with pytest.raises(BusError, match="puck 3 does not tell its position"):
        talk.told_positions(question, (1, 2, 3, 4))


@pytest.mark.parametrize("by", [1025, -1025])
def test_an_arm_that_was_moved_either_way_is_told(by):
    fake = FakeArm().awake()
    arm, _ = start(fake)
    talk = Dialogue(arm.bus, fake)
    fake.values[2]["P"] += 1024 if by > 0 else -1024
    assert arm.moved(talk) is None
    fake.values[2]["P"] = arm.counts[1] + by
    assert arm.moved(talk) == 1


class Twice(FakeArm):
    """Each answer of a node comes twice, once or always; the other one tells another position."""

    def __init__(self, times, *nodes):
        super().__init__()
        self.nodes, self.times = nodes, times

    def answer(self, node, name, number):
        super().answer(node, name, number)
        if node in self.nodes and self.times:
            self.times -= 1
            kept = self.values[node][name]
            if name == "P":
                self.values[node][name] = kept + 5
            super().answer(node, name, number)
            self.values[node][name] = kept


@pytest.mark.parametrize(("node", "name"), [(1, "puck 1"), (4, "puck 4"), (8, "the force"), (10, "the safety")])
def test_two_nodes_of_one_number_are_told_before_anything_is_set(node, name):
    fake = Twice(10**9, node)
    with pytest.raises(BusError, match=f"two nodes answer as {name}.*number of its own"):
        start(fake)
    assert fake.orders == []


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_frame_that_comes_twice_is_no_second_node(times):
    start(Twice(times, 2))


def test_an_adapter_that_tells_every_frame_twice_is_none_either():
    start(Twice(10**9, 1, 2, 3, 4, 8, 10))
