"""An interface that is down, bursts, waits while the wall clock jumps, and a second controller."""

import errno
import socket
import time

import can
import pytest

from deploy.bus import receive_buffer
from deploy.bus.bus import Bus
from deploy.errors import BusError
from deploy.puck.frame import Frame
from tests.deploy.test_bus import POSITION, Clock, Scripted, message
from tests.deploy.test_startup import MS, FakeArm, start

DOWN = can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN)
QUESTION = Frame(0x00A, b"\x05")


class Link(FakeArm):
    """As socketcan behaves: the first receive of a link that went down raises, later ones are silent, sending fails."""

    def __init__(self):
        super().__init__()
        self.up_at, self._told_down, self.channel = 10**18, False, "can3"

    def _recv_internal(self, timeout):
        if self.ns < self.up_at and not self._told_down:
            self._told_down = True
            raise can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
        return super()._recv_internal(timeout)

    def send(self, msg, timeout=None):
        if self.ns < self.up_at:
            raise DOWN
        super().send(msg, timeout)


@pytest.mark.parametrize("how", ["send", "receive"])
def test_link_down_reads_as_link_down(how):
    driver = Scripted()
    bus = Bus(driver, Clock().now)
    bus.name = "can3"
    if how == "send":
        driver.send_error = DOWN
        assert not bus.send(POSITION)
    else:
        driver.receive_error = DOWN
        assert bus.receive(0.01) is None
    assert bus.state == "down"
    assert "ip link set can3 up" in bus.remedy
    assert "Network is down" in bus.remedy


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENXIO])
def test_an_interface_that_is_gone_is_off_for_good(number):
    driver = Scripted()
    bus = Bus(driver, Clock().now)
    driver.send_error = can.CanOperationError("Failed to transmit: No such device", number)
    bus.send(POSITION)
    assert bus.state == "off"
    driver.send_error = None
    assert not bus.recover(QUESTION)


def test_after_link_up_it_recovers_when_asked_to_and_never_by_itself():
    driver = Scripted()
    bus = Bus(driver, Clock().now)
    driver.send_error = driver.receive_error = DOWN
    bus.send(POSITION)
    assert not bus.recover(QUESTION)
    driver.send_error = driver.receive_error = None
    driver.queue.append(message())
    assert bus.receive(0.0) == (POSITION, 0)
    assert bus.send(POSITION)
    assert bus.state == "down"
    assert bus.recover(QUESTION)
    assert bus.state == "active"
    assert bus.counters.send_errors == 2


def test_start_up_waits_for_a_link_that_comes_up_and_names_the_command():
    fake = Link()
    fake.up_at = 600 * MS
    arm, said = start(fake.awake())
    assert arm.bus.state == "active"
    assert any("ip link set" in sentence for sentence in said)

    with pytest.raises(BusError, match=r"it is down.*Network is down.*ip link set can3 up") as refused:
        start(Link().awake())
    assert "terminator" not in str(refused.value)


def test_a_second_controller_says_nothing_where_the_first_is_at_work():
    fake = FakeArm().awake()
    sent, send = [], fake.send
    fake.send = lambda msg, timeout=None: (sent.append(msg), send(msg))
    hear = fake._recv_internal

    def at_work(timeout):
        """The first controller's frames, three in every millisecond."""
        if fake.ns // (MS // 3) > at_work.count:
            at_work.count += 1
            return message(id=(0x404, 0x008, 0x401)[at_work.count % 3], data=b"\x30"), False
        return hear(timeout)

    at_work.count = 0
    fake._recv_internal = at_work
    with pytest.raises(BusError, match=r"somebody else commands on this bus.*nothing was sent"):
        start(fake)
    assert sent == []


class Datagrams(can.BusABC):
    """A bus with a socket of the kernel's own; AF_CAN is not everywhere, its buffer is that of any socket."""

    def __init__(self, size=None):
        super().__init__(channel="datagrams")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if size is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)

    def _recv_internal(self, timeout):
        try:
            data = self.socket.recv(16)
        except BlockingIOError:
            return None, False
        return message(data=data[:8]), False

    def send(self, msg, timeout=None):
        raise NotImplementedError

    def shutdown(self):
        super().shutdown()
        self.socket.close()


def burst(port, count):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(count):
            sender.sendto(bytes([k >> 8, k & 255, 0]), ("127.0.0.1", port))


def all_of(bus):
    got = []
    while frames := bus.drain(256):
        got += [int.from_bytes(frame.data[:2], "big") for frame, _ in frames]
    return got


def test_a_burst_of_2000_frames_is_kept_whole_to_the_newest():
    driver = Datagrams()
    usual = driver.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    bus = Bus(driver)
    try:
        if bus.buffer <= usual:
            pytest.skip("this system grants no larger buffer")
        burst(driver.socket.getsockname()[1], 2000)
        assert all_of(bus) == list(range(2000))
        assert bus.count_dropped() == 0
    finally:
        bus.close()


def test_what_the_kernel_drops_is_counted(monkeypatch):
    monkeypatch.setattr(receive_buffer, "enlarge", lambda sock: 0)  # as it was: the newest frames are lost, silently
    driver = Datagrams(size=4096)
    bus = Bus(driver)
    try:
        burst(driver.socket.getsockname()[1], 2000)
        got = all_of(bus)
        assert got == list(range(len(got)))
        assert 0 < len(got) < 1000
        assert bus.count_dropped() == bus.counters.dropped == 2000 - len(got)
    finally:
        bus.close()
    assert bus.count_dropped() == 2000 - len(got)


def test_where_there_is_no_socket_nothing_is_counted():
    assert Bus(Scripted()).count_dropped() == 0
    assert receive_buffer.socket_of(Scripted()) is None
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as stream:
        driver = Scripted()
        driver.socket = stream
        assert receive_buffer.socket_of(driver) is None


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_real_interface_is_waited_for_by_the_monotonic_clock(monkeypatch, step):
    """python-can's own `recv` waits 6 s of 1 s where the wall clock is set back by 5."""
    bus = Bus(can.Bus(interface="virtual", channel="clock"))
    wall = [time.time()]

    def jumping():
        wall[0] += step
        return wall[0]

    monkeypatch.setattr("time.time", jumping)
    monkeypatch.setattr("can.bus.time", jumping)
    try:
        start_ns = time.monotonic_ns()
        assert bus.receive(0.2) is None
        assert 0.2 <= (time.monotonic_ns() - start_ns) * 1e-9 < 0.7
    finally:
        monkeypatch.undo()
        bus.close()


def test_a_wait_that_is_over_is_no_error():
    bus = Bus(can.Bus(interface="virtual", channel="negative"))
    try:
        assert bus.receive(-0.5) is None
        assert bus.state == "active"
    finally:
        bus.close()
