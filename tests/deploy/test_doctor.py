import random
from argparse import ArgumentParser, Namespace

import can
import pytest

from deploy import doctor
from deploy.cli import doctor as verb
from deploy.controller.file import to_bytes
from deploy.controller.freeze import freeze
from deploy.doctor import Traffic, bits
from jaxmpc.files.errors import InputError
from tests.deploy.fake_arm import PENDANT
from tests.deploy.pendants import encode_pendant

MS = 1_000_000


class FakeClock:
    """Waits exactly as late as told, over and over."""

    def __init__(self, *lateness):
        self.time, self.lateness, self.waits = 0, lateness, 0

    def now(self):
        return self.time

    def wait_until(self, deadline):
        self.time = max(self.time, deadline + self.lateness[self.waits % len(self.lateness)])
        self.waits += 1


def stuffed(sequence):
    """Bits on the wire: after five equal ones comes one of the other kind, which counts for the next five."""
    wire, run = [], 0
    for bit in sequence:
        run = run + 1 if wire and bit == wire[-1] else 1
        wire.append(bit)
        if run == 5:
            wire.append(1 - bit)
            run = 1
    return len(wire)


@pytest.mark.parametrize(("n", "worst"), [(1, 65), (3, 85), (4, 95), (6, 115), (7, 125), (8, 135)])
def test_longest_frames_against_the_table_and_against_stuffing(n, worst):
    assert bits(n) == worst
    # 34 + 8n bits are stuffed: one of each kind after the first five, then every four
    length = 34 + 8 * n
    pattern = ([0] * 5 + ([1] * 4 + [0] * 4) * length)[:length]
    assert stuffed(pattern) + 13 == worst
    draw = random.Random(n)
    for _ in range(300):
        assert stuffed([draw.random() < 0.2 for _ in range(length)]) + 13 <= worst


@pytest.mark.parametrize(
    ("traffic", "worst"),
    [(Traffic(4, False), 540), (Traffic(4, True), 845), (Traffic(4, True, 1.0), 1025), (Traffic(7, False), 930)],
)
def test_budget_of_a_cycle(traffic, worst):
    assert traffic.microseconds == worst


@pytest.mark.parametrize(
    ("joints", "sensor", "rate", "level"),
    [
        (4, True, 1000.0, "ok"),
        (4, False, 1000.0, "ok"),
        (4, False, 1600.0, "ok"),
        (4, True, 1100.0, "wrong"),
        (7, False, 1000.0, "wrong"),
        (7, True, 500.0, "ok"),
        (7, True, 1000.0, "wrong"),
    ],
)
def test_seven_joints_at_a_kilohertz_are_refused(joints, sensor, rate, level):
    lines, finding = doctor.budget(joints, sensor, rate)
    assert finding.level == level
    assert ("too much" in lines[-1]) == (level == "wrong")
    if level == "wrong":
        assert "Hz or slower" in finding.text
    assert len({len(line.removesuffix("   too much")) for line in lines}) == 1


def test_versions_name_the_packages():
    texts = [finding.text for finding in doctor.versions()]
    assert any(text.startswith("numpy 2") for text in texts)
    assert f"python-can {can.__version__}" in texts
    assert not [finding for finding in doctor.versions() if finding.level == "wrong"]


def test_punctual_waits():
    clock = FakeClock(4_000, 8_000)
    found = doctor.machine(1000.0, clock=clock)
    assert clock.waits == 1000
    assert "late by 5 µs (median), 8 µs (99 %), 8 µs (most)" in found[-1].text
    assert found[-1].level == "ok"


@pytest.mark.parametrize(("late", "level"), [(0, "ok"), (1, "note"), (2, "note"), (3, "wrong")])
def test_waits_that_would_stop_a_run(late, level):
    clock = FakeClock(*[2 * MS if k < 2 * late and k % 2 else 0 for k in range(1000)])
    assert doctor.machine(1000.0, clock=clock)[-1].level == level


def test_a_real_second_is_given_back():
    assert len(doctor.machine(1000.0, seconds=0.02)) == 8


@pytest.mark.parametrize(("needed", "level"), [(True, "wrong"), (False, "ok")])
def test_without_comedi(tmp_path, needed, level):
    finding = doctor.jr3(needed, tmp_path)
    assert finding.level == level
    assert ("modprobe" in finding.text) == needed


def test_comedi_devices(tmp_path, monkeypatch):
    (tmp_path / "comedi0").touch()
    assert doctor.jr3(True, tmp_path).level == "ok"
    monkeypatch.setattr("os.access", lambda *_: False)
    assert doctor.jr3(True, tmp_path).level == "wrong"
    assert doctor.jr3(False, tmp_path).level == "note"


def test_controllers(tmp_path, arm_artifact, arguments):
    path = tmp_path / "arm.npz"
    path.write_bytes(to_bytes(arm_artifact))
    finding, artifact = doctor.controller(path)
    assert finding.level == "ok"
    assert "Barrett WAM 4-DoF at 1000 Hz" in finding.text
    assert artifact is not None
    freeze(tmp_path / "linear.npz", **arguments)
    assert "only replays" in doctor.controller(tmp_path / "linear.npz")[0].text
    path.write_bytes(path.read_bytes()[:-1])
    finding, artifact = doctor.controller(path)
    assert (finding.level, artifact) == ("wrong", None)
    assert "cut short" in finding.text


class Robot(can.Listener):
    """Nodes that answer questions for STAT and MODE on a virtual bus."""

    def __init__(self, channel, nodes, mode=1, broken=()):
        self.broken = broken
        self.bus = can.Bus(interface="virtual", channel=channel)
        # STAT, MODE; of pucks VERS, ROLE, GRPB, CTS, IPNM, MT
        self.values = {5: 2, 8: mode, 0: 150, 1: 0x100, 27: 1, 68: 4096, 86: 2700, 43: 4860}
        # ROLE, ZERO and PEN of the safety module
        self.safety, self.nodes, self.asked = {1: 2, 42: 1, 43: encode_pendant(PENDANT)}, nodes, []
        self.notifier = can.Notifier(self.bus, [self], timeout=0.005)

    def on_message_received(self, msg):
        self.asked.append((msg.arbitration_id, bytes(msg.data)))
        if msg.arbitration_id in self.nodes and len(msg.data) == 1:
            number = msg.data[0]
            known = self.values | (self.safety if msg.arbitration_id == 10 else {})
            value = msg.arbitration_id if number == 70 else known[number]
            value = 1 if number == 5 and msg.arbitration_id in self.broken else value
            data = bytes((0x80 | number, 0)) + value.to_bytes(4, "little")
            reply = can.Message(arbitration_id=0x406 | msg.arbitration_id << 5, data=data, is_extended_id=False)
            self.bus.send(reply)

    def close(self):
        self.notifier.stop()
        self.bus.shutdown()


def ask(channel, nodes, mode=1, sensor=True, broken=(), limits=None, cap=4860):
    """What the doctor finds; its robot is a thread, which on a busy machine may be late."""
    robot = Robot(channel, nodes, mode, broken)
    robot.values[43] = cap
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(doctor, "_ANSWER_S", 0.2)
            found = doctor.bus(Namespace(interface="virtual", channel=channel), sensor, limits)
    finally:
        robot.close()
    assert all(len(data) == 1 for _, data in robot.asked)  # questions, never orders
    return found


@pytest.fixture
def channel(tmp_path):
    """A name that no other test has."""
    return tmp_path.name


EVERYBODY = (1, 2, 3, 4, 8, 10)


@pytest.mark.parametrize(
    ("nodes", "mode", "sensor", "levels", "text"),
    [
        (EVERYBODY, 1, True, ["ok", "ok"], "nodes 1, 2, 3, 4, 8, 10 answer"),
        (EVERYBODY, 0, True, ["ok", "note"], "e-stop"),
        (EVERYBODY, 2, True, ["ok", "wrong"], "press Shift-idle"),
        ((1, 2, 3, 4, 10), 1, True, ["ok", "wrong", "ok"], "force sensor"),
        ((1, 2, 3, 4, 10), 1, False, ["ok", "ok"], "idle"),
        ((1, 2, 4, 8, 10), 1, True, ["ok", "wrong", "ok"], "pucks 3 do not answer"),
        ((1, 2, 3, 4, 8), 1, True, ["ok", "wrong"], "pendant connected"),
        ((), 1, True, ["wrong"], "nobody answers"),
    ],
    ids=str,
)
def test_who_answers(channel, nodes, mode, sensor, levels, text):
    found = ask(channel, nodes, mode, sensor)
    assert [finding.level for finding in found] == levels
    assert text in "\n".join(finding.text for finding in found)


@pytest.mark.parametrize(("sensor", "named"), [(True, "nodes 3, 8 report"), (False, "nodes 3 report")])
def test_a_puck_with_an_error_prevents_a_run(channel, sensor, named):
    found = ask(channel, EVERYBODY, sensor=sensor, broken=(3, 8))
    assert [finding.level for finding in found] == ["ok", "wrong", "ok"]
    assert f"{named} an error (STAT 1)" in found[1].text


@pytest.mark.parametrize(("cap", "levels"), [(4860, []), (4700, ["note"]), (2000, ["wrong"])])
def test_pucks_that_give_less_torque_than_the_controller_counts_on(channel, arm_artifact, cap, levels):
    found = ask(channel, EVERYBODY, limits=arm_artifact.arm.limits, cap=cap)
    assert [finding.level for finding in found] == ["ok", *levels, "ok"]
    assert all("torque" in finding.text for finding in found[1:-1])


def test_another_controller_on_the_bus_is_left_alone(channel):
    with can.Bus(interface="virtual", channel=channel) as other:
        message = can.Message(arbitration_id=0x404, data=b"\x30", is_extended_id=False)
        task = other.send_periodic(message, 0.01)
        try:
            (finding,) = doctor.bus(Namespace(interface="virtual", channel=channel), True)
        finally:
            task.stop()
    assert finding.level == "wrong"
    assert "another controller" in finding.text


def test_a_bus_that_is_not_there():
    (finding,) = doctor.bus(Namespace(interface="slcan", channel="/dev/no-such-device"), True)
    assert finding.level == "wrong"
    assert "cannot be opened" in finding.text


def run(*words):
    parser = ArgumentParser()
    verb.configure(parser)
    return verb.run(parser.parse_args([str(word) for word in words]))


@pytest.fixture
def quiet(monkeypatch):
    """A machine whose clock is always on time."""
    monkeypatch.setattr(doctor, "MonotonicClock", lambda: FakeClock(1000))


@pytest.mark.usefixtures("quiet")
def test_the_verb(tmp_path, arm_artifact, capsys):
    path = tmp_path / "arm.npz"
    path.write_bytes(to_bytes(arm_artifact))
    assert run("--artifact", path) == 0
    out = capsys.readouterr().out
    for words in ("numpy", "monotonic", "bus: not looked at", "this run: 4 joints, force sensor", "sha256"):
        assert words in out
    assert out.endswith("nothing prevents a run\n")
    assert run("--joints", "7") == 1
    assert "1 to be put right before a run" in capsys.readouterr().out
    assert run("--artifact", path, "--rate", "500") == 1
    assert "the controller's law runs at 1000 Hz, not 500" in capsys.readouterr().out
    assert run("--artifact", tmp_path / "none.npz") == 1
    assert run("--sensor", "none") == 0
    assert run("--interface", "slcan", "--channel", "/dev/no-such-device") == 1


@pytest.mark.usefixtures("quiet")
def test_a_serial_line_which_a_run_refuses_prevents_one(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "bus", lambda *_: [doctor.Finding("ok", "bus: open")])
    assert run("--interface", "slcan", "--channel", "/dev/ttyACM0") == 1
    assert "slcand -o -s8 DEVICE can0" in capsys.readouterr().out


@pytest.mark.parametrize("rate", ["nan", "0.4", "1e10", "1e-320"])
def test_a_rate_that_is_none(rate):
    with pytest.raises(InputError, match="10000"):
        run("--rate", rate)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--bitrate", "500000"), "--bitrate = 500000: must be 1000000 bit/s"),
        (("--fd",), "--fd = given: must be left out"),
        (("--channel", "can0"), r"--interface = left out: .* as --interface socketcan --channel can0\.$"),
    ],
)
def test_flags_of_no_bus_of_an_arm_are_refused_at_once(words, said, monkeypatch):
    monkeypatch.setattr(doctor, "machine", lambda rate: pytest.fail("the machine was looked at first"))
    with pytest.raises(InputError, match=said):
        run(*words)
