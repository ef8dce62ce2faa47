from collections import deque
from itertools import pairwise

import can
import pytest

from deploy.bus.bus import Bus
from deploy.errors import BusError, CalibrationError
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted, Wrench
from deploy.puck import codec, properties
from deploy.puck.codec import decode
from deploy.puck.frame import Frame
from deploy.puck.messages import Get, Set
from deploy.puck.pendant import Pendant
from deploy.wam.startup import startup
from tests.deploy.pendants import encode_pendant

MS = 1_000_000
HOME_COUNTS = [0, -36833, 36832, -36728]  # wam.md §3.2
PENDANT = Pendant("none", False, True, "0", "SAFE", "SAFE", "SAFE", "SAFE", "SAFE")
KINDS = {1: "motor", 2: "motor", 3: "motor", 4: "motor", 8: "force", 10: "safety"}


class FakeArm(can.BusABC):
    """Nodes that hold properties and answer at once; time is what the bus or the caller lets pass."""

    def __init__(self, zero=1, version=150):
        super().__init__(channel="fake")
        self._is_shutdown = True  # nothing to give back
        self.ns, self.queue, self.orders, self.silent, self.lose, self.deaf = 0, deque(), [], set(), 0, set()
        self.asked = 0
        self.versions = {node: version for node in (1, 2, 3, 4)} | {8: 24, 10: 197}
        self.values = {node: {"VERS": v, "STAT": 0} for node, v in self.versions.items()}
        for node in (1, 2, 3, 4):
            puck = {"ROLE": 0x100, "PIDX": node, "CTS": 4096, "IPNM": 2700, "MT": 4860, "MODE": 2, "MECH": 0}
            self.values[node] |= puck | {"GRPA": 0, "GRPB": 1, "GRPC": 4, "P": HOME_COUNTS[node - 1]}
        self.values[8] |= {"ROLE": 6, "FT": 0}
        safety = {"ROLE": 2, "MODE": 1, "ZERO": zero, "PEN": encode_pendant(PENDANT), "IFAULT": 0, "STAT": 2}
        self.values[10] |= safety | {"VL1": 1, "VL2": 4096, "TL1": 1, "TL2": 5204, "DEF": 0, "LOAD": 0}

    # the clock
    def now(self):
        return self.ns

    def wait_until(self, deadline_ns):
        self.ns = max(self.ns, deadline_ns)

    # the driver
    def _recv_internal(self, timeout):
        if self.queue:
            frame = self.queue.popleft()
            return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False), False
        return None, False

    def send(self, msg, timeout=None):
        frame = Frame(msg.arbitration_id, bytes(msg.data))
        said = decode(frame)
        nodes = (1, 2, 3, 4) if frame.id & 0x400 else (frame.id,)
        for node in nodes:
            if node not in self.values or node in self.silent:
                continue
            names = {properties.number(name, KINDS[node], self.versions[node]): name for name in self.values[node]}
            name = names.get(said.property)
            if isinstance(said, Set):
                self.orders.append((self.ns, node, name, said.value))
                if name is not None and (node, name) not in self.deaf:
                    self.values[node][name] = said.value
            elif name is not None:
                self.asked += 1
                self.answer(node, name, said.property)

    def answer(self, node, name, number):
        if self.lose:
            self.lose -= 1
            return
        value = self.values[node][name]
        if name == "P":
            self.queue.append(codec.encode_position(node, value))
        else:
            self.queue.append(codec.encode_property(node, number, value))

    def awake(self):
        for values in self.values.values():
            values["STAT"] = 2
        return self

    def told(self, *names):
        return [(node, name, value) for _, node, name, value in self.orders if name in names]


def start(fake, **settings):
    said = []
    arm = startup(Bus(fake, fake.now), fake, Mounted(CanSensor()), report=said.append, **settings)
    return arm, said


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


def test_without_being_told_home_is_not_set():
    fake = FakeArm(zero=0)
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


def test_enumeration_asks_every_node_once():
    fake = FakeArm().awake()
    asked = []
    send = fake.send
    fake.send = lambda msg, timeout=None: (asked.append(Frame(msg.arbitration_id, bytes(msg.data))), send(msg))
    start(fake)
    assert [decode(frame) for frame in asked[:31]] == [Get(node, 5) for node in range(1, 32)]
