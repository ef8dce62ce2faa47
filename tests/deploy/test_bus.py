import argparse
import errno
import time
from collections import deque

import can
import pytest

from deploy.bus import bus as bus_module
from deploy.bus.bus import SENDS_AFTER_ERROR, Bus
from deploy.bus.interface import add_arguments, open_bus
from deploy.errors import BusError
from deploy.puck.frame import Frame
from jaxmpc.files.errors import InputError

POSITION = Frame(0x423, b"\x00\x00\x02")
MS = 1_000_000


class Clock:
    def __init__(self):
        self.ns = 0

    def now(self):
        return self.ns


class Scripted(can.BusABC):
    """A driver that gives what is put in, and fails when told to."""

    def __init__(self):
        super().__init__(channel="scripted")
        self.queue, self.sent, self.send_error, self.receive_error = deque(), [], None, None
        self._is_shutdown = True  # nothing to give back

    def _recv_internal(self, timeout):
        if self.receive_error:
            raise self.receive_error
        return (self.queue.popleft() if self.queue else None), False

    def send(self, msg, timeout=None):
        assert timeout == 0.0  # None would let a driver wait as long as it likes
        if self.send_error:
            raise self.send_error
        self.sent.append(Frame(msg.arbitration_id, bytes(msg.data)))


def message(id=0x423, data=b"\x00\x00\x02", extended=False, **more):
    return can.Message(arbitration_id=id, data=data, is_extended_id=extended, **more)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def driver():
    return Scripted()


@pytest.fixture
def bus(driver, clock):
    return Bus(driver, clock.now)


def test_frames_are_stamped_by_our_clock(bus, driver, clock):
    clock.ns = 123
    driver.queue.append(message(timestamp=1e9))  # the driver's own stamp is of another clock
    assert bus.receive(0.0) == (POSITION, 123)
    assert bus.receive(0.0) is None


@pytest.mark.parametrize(
    ("wrong", "counter"),
    [
        (message(extended=True), "malformed"),
        (message(id=0x1FFFF423, extended=True), "malformed"),
        (message(is_remote_frame=True), "malformed"),
        (message(is_fd=True), "malformed"),
        (message(data=bytes(12), is_fd=True), "malformed"),
        (message(is_error_frame=True, id=0x80), "malformed"),
        (message(id=0x4A3), "foreign"),  # puck 5
        (message(id=0x7E3), "foreign"),
        (message(id=0x020), "received"),  # puck 1 to the host itself: ours, though nobody asks for it
        (message(id=0x401), "hosts"),
        (message(id=0x001), "hosts"),
    ],
)
def test_what_is_not_ours_is_dropped_and_counted(bus, driver, wrong, counter):
    driver.queue.extend([wrong, message()])
    if counter == "received":
        bus.receive(0.0)
    assert bus.receive(0.0)[0] == POSITION
    counts = {name: getattr(bus.counters, name) for name in bus.counters.__slots__}
    expected = dict.fromkeys(counts, 0) | {"received": 1}
    expected[counter] += 1
    expected["foreign"] = max(expected["foreign"], expected["hosts"])
    assert counts == expected
    assert bus.state == "active"


def test_all_wrong_things_at_once_cost_no_frame_of_ours(bus, driver):
    for i in range(1000):
        driver.queue.append(message(id=0x7E3) if i % 10 else message(data=bytes([0, 0, i % 256])))
    driver.queue.append(message(data=b"\x00\x00\xff"))
    got = []
    while (frame := bus.receive(0.0)) is not None:
        got.append(frame[0].data[2])
    assert got == [i % 256 for i in range(0, 1000, 10)] + [255]
    assert bus.counters.foreign == 900


def test_babble_does_not_hold_a_call_that_has_no_time(bus, driver):
    driver.queue.extend(message(id=0x7E3) for _ in range(10_000))
    assert bus.receive(0.0) is None
    assert bus.drain() == []
    assert 10_000 - len(driver.queue) < 300


def test_within_its_time_a_call_reads_through_babble(clock):
    class Timed(Scripted):
        def _recv_internal(self, timeout):
            clock.ns += MS // 100
            return super()._recv_internal(timeout)

    driver = Timed()
    bus = Bus(driver, clock.now)
    driver.queue.extend(message(id=0x7E3) for _ in range(80))
    driver.queue.append(message())
    assert bus.receive(1e-3)[0] == POSITION


def test_drain_and_flush(bus, driver):
    driver.queue.extend(message() for _ in range(100))
    assert len(bus.drain(30)) == 30
    assert not bus.dry
    driver.queue.extendleft(message(id=0x7E3) for _ in range(500))
    assert bus.flush() == 70
    assert not driver.queue
    assert bus.drain() == []
    assert bus.dry


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Transmit buffer full", errno.ENOBUFS),
        can.CanTimeoutError("no"),
        OSError(errno.ENETDOWN, "down"),
        BrokenPipeError(),
        ValueError("closed"),
        IndexError("none of python-can's own"),
    ],
)
def test_after_an_error_less_than_5_sends_a_second_are_tried(bus, driver, clock, error):
    assert bus.send(POSITION)
    driver.send_error = error
    tried = []
    refuse, driver.send_error = driver.send_error, None

    def send(msg, timeout=None):
        tried.append(clock.ns)
        raise refuse

    driver.send = send
    for _ in range(5000):
        assert not bus.send(POSITION)
        clock.ns += MS
    assert bus.state == ("down" if getattr(error, "errno", None) == errno.ENETDOWN else "error")
    assert bus.counters.send_errors == len(tried) == 5 * SENDS_AFTER_ERROR
    assert bus.counters.held == 5000 - len(tried)
    assert all(later - earlier >= 1000 * MS for earlier, later in zip(tried, tried[SENDS_AFTER_ERROR:], strict=False))
    # the frames that lower the arm's state go out at once, though
    assert tried[:3] == [0, MS, 2 * MS]


def test_whatever_a_driver_raises_as_it_reads_is_counted(bus, driver):
    driver.receive_error = IndexError("half a line of a serial adapter")
    assert bus.drain() == []
    assert bus.receive(0.0) is None
    assert (bus.state, bus.counters.receive_errors) == ("off", 2)


def test_an_error_is_never_forgotten(bus, driver, clock):
    driver.send_error = can.CanOperationError("full")
    bus.send(POSITION)
    driver.send_error = None
    clock.ns += 10_000 * MS
    assert bus.send(POSITION)
    assert bus.state == "error"


@pytest.mark.parametrize("error", [can.CanError("gone"), OSError(errno.ENETDOWN, "down"), ValueError("closed")])
def test_a_lost_interface_is_seen_when_reading(bus, driver, error):
    driver.receive_error = error
    assert bus.receive(0.01) is None
    assert bus.drain() == []
    assert bus.flush() == 0
    assert bus.state == ("down" if getattr(error, "errno", None) == errno.ENETDOWN else "off")
    assert bus.counters.receive_errors > 0


@pytest.mark.parametrize(
    ("id", "data", "state"),
    [
        (0x40, b"\x00" * 8, "off"),
        (0x04, b"\x00\x10" + b"\x00" * 6, "error"),  # receiver passive
        (0x04, b"\x00\x20" + b"\x00" * 6, "error"),  # sender passive
        (0x04, b"\x00\x08" + b"\x00" * 6, "active"),  # a warning
        (0x04, b"\x00", "active"),  # without the byte that would tell
        (0x02, b"\x00" * 8, "active"),  # arbitration lost
    ],
)
def test_error_frames_tell_bus_off_and_passive(bus, driver, id, data, state):
    driver.queue.append(message(id=id, data=data, extended=True, is_error_frame=True))
    assert bus.receive(0.0) is None
    assert bus.state == state
    assert bus.counters.malformed == 1


@pytest.mark.parametrize(("said", "state"), [("ERROR", "off"), ("PASSIVE", "error"), ("ACTIVE", "active")])
def test_a_driver_that_knows_the_state_is_believed(clock, said, state):
    class Knowing(Scripted):
        state = can.BusState[said]

    assert Bus(Knowing(), clock.now).state == state


@pytest.mark.parametrize(
    ("error", "state"), [(RuntimeError("no such device"), "off"), (OSError(errno.ENETDOWN, "down"), "down")]
)
def test_a_driver_that_cannot_tell_its_state_is_off_the_bus(clock, error, state):
    """As one whose adapter was pulled out: an order to idle must still be tried."""

    class Unplugged(Scripted):
        @property
        def state(self):
            raise error

    driver = Unplugged()
    bus = Bus(driver, clock.now)
    assert bus.state == state
    assert bus.counters.receive_errors == 1
    assert bus.send(Frame(0x404, bytes((0x88, 0, 0, 0, 0, 0))))
    assert len(driver.sent) == 1


def test_waiting_ends_though_the_wall_clock_is_set_back(monkeypatch):
    # python-can's own recv measures on time.time()
    class Patient(Scripted):
        def _recv_internal(self, timeout):
            time.sleep(min(timeout, 0.005))
            return None, False

    wall = iter(range(10**9, 0, -3600))
    monkeypatch.setattr("can.bus.time", lambda: next(wall))
    start = time.monotonic()
    assert Bus(Patient()).receive(0.02) is None
    assert 0.02 <= time.monotonic() - start < 5.0


def test_closing_never_raises(clock):
    class Broken(Scripted):
        def shutdown(self):
            super().shutdown()
            raise RuntimeError("driver bug")

    bus = Bus(Broken(), clock.now)
    bus.close()
    assert bus.state == "off"


def test_a_driver_without_its_own_reader_works():
    class Legacy(can.BusABC):
        def __init__(self):
            super().__init__(channel="legacy")

        def recv(self, timeout=None):
            return message()

        def send(self, msg, timeout=None):
            pass

    assert Bus(Legacy()).receive(0.0)[0] == POSITION


def parsed(*flags):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(flags)


def test_the_flags_are_python_cans():
    bus = open_bus(parsed("--interface", "virtual", "--channel", "test-bus"))
    peer = can.Bus(interface="virtual", channel="test-bus")
    try:
        peer.send(message())
        assert bus.receive(1.0)[0] == POSITION
        assert bus.send(Frame(0x404, b"\x30"))
        received = peer.recv(1.0)
        assert (received.arbitration_id, bytes(received.data), received.is_extended_id) == (0x404, b"\x30", False)
    finally:
        bus.close()
        peer.shutdown()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--interface", "virtual", "--channel", "can0; rm"), "the name of a CAN channel"),
        ((), r"Name one, as --interface socketcan --channel can0\.$"),
        (("--interface", "virtual", "--channel", "a", "--fd"), "--fd = given: must be left out"),
        (("--interface", "virtual", "--channel", "a", "--bitrate", "500000"), "1 Mbit/s"),
    ],
)
def test_flags_of_no_bus_of_an_arm_are_wrong_input(flags, says):
    with pytest.raises(InputError, match=says):
        open_bus(parsed(*flags))


def test_a_bus_may_be_named_in_the_environment(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "of-the-environment")
    open_bus(parsed()).close()


def test_an_environment_that_cannot_be_read_is_told_as_of_the_bus(monkeypatch):
    monkeypatch.setenv("CAN_CONFIG", "{")
    with pytest.raises(BusError, match="settings name cannot be opened"):
        open_bus(parsed())


def test_what_cannot_be_opened_is_one_sentence():
    with pytest.raises(BusError, match="check --interface and --channel") as raised:
        open_bus(parsed("--interface", "socketcan", "--channel", "nosuchcan"))
    assert "\n" not in str(raised.value)


def test_a_millisecond_of_frames_fits_the_bound():
    assert bus_module.MOST_AT_ONCE > 1000 / 55  # the shortest frame lasts 55 µs (wam.md §6)
