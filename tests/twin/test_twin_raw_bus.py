"""The twin as a node of any bus of python-can: one message a frame, in and out."""

import signal
import threading
import time
from contextlib import closing
from importlib.util import find_spec

import can
import pytest

from deploy.bus.bus import Bus
from deploy.errors import BusError
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.loop.realtime import MonotonicClock
from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.twin.raw_bus import HOPELESS, RawBus
from deploy.twin.scenario import motion_named
from deploy.twin.server import Server
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from deploy.wam.startup import startup
from jaxmpc.cli import main
from tests.deploy.test_bus import Scripted, message

pytestmark = pytest.mark.once

P = 48
INTERFACES = [
    pytest.param({"interface": "virtual", "channel": "wam"}, id="virtual"),
    pytest.param(
        {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 43113},
        id="udp_multicast",
        marks=pytest.mark.skipif(find_spec("msgpack") is None, reason="python-can's udp_multicast needs msgpack"),
    ),
]


@pytest.fixture(params=INTERFACES)
def serve(request):
    """A twin on a bus, and somebody else's end of that bus."""
    running = []

    def start(**settings):
        try:
            node, peer = can.Bus(**request.param), can.Bus(**request.param)
        except (OSError, can.CanError) as error:
            pytest.skip(f"{request.param['interface']} does not work here: {error}")
        server = Server(Twin(TwinSettings(**{"motion": motion_named("none")} | settings)), None)
        server.join(RawBus(node))
        thread = threading.Thread(target=server.run)
        running.append((server, thread, peer))
        thread.start()
        return server, peer

    yield start
    for server, thread, peer in running:
        server.stop()
        thread.join()
        server.close()
        peer.shutdown()


def hear(bus, count, seconds=5.0):
    frames, until = [], time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < until:
        got = bus.recv(0.1)
        # udp_multicast gives everybody's frames back to their sender, too
        if got is None or ("Udp" in type(bus).__name__ and (got.is_extended_id or not got.arbitration_id & 0x3E0)):
            continue
        frames.append(got)
    return frames


def send(bus, frame):
    bus.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))


def test_pucks_and_sensor_answer_in_plain_frames(serve):
    _, bus = serve()
    send(bus, codec.get(0x404, P))
    send(bus, codec.get(8, 54))
    found = hear(bus, 6)
    assert [codec.decode(Frame(each.arbitration_id, bytes(each.data))).node for each in found[:4]] == [1, 2, 3, 4]
    assert [each.arbitration_id for each in found[4:]] == [0x50A, 0x50B]
    assert not any(each.is_extended_id or each.is_fd or each.is_error_frame for each in found)


def test_an_arm_starts_up_over_it_and_answers_in_its_cycles(serve):
    server, peer = serve()
    clock, bus = MonotonicClock(), Bus(peer)
    if "Udp" in type(peer).__name__:  # it cannot know its own frames from those of another controller
        with pytest.raises(BusError, match="somebody else commands"):
            startup(bus, clock, Mounted(CanSensor()))
        return
    arm = startup(bus, clock, Mounted(CanSensor()))
    came = 0
    for _ in range(50):
        arm.request()
        reading = arm.collect(clock.now() + 500_000_000)
        came += None not in reading.counts and reading.force is not None
    assert came >= 45  # whatever else this machine does
    assert bus.state == "active"
    assert server.twin.counters["not understood"] == 0


def test_what_no_puck_would_take_is_counted_and_dropped(serve):
    server, bus = serve()
    bus.send(can.Message(arbitration_id=0x404, data=b"\x30", is_extended_id=True))
    bus.send(can.Message(arbitration_id=0x404, is_remote_frame=True, is_extended_id=False))
    send(bus, codec.get(10, 8))
    (answer,) = hear(bus, 1)
    assert answer.arbitration_id == 0x546
    server.stop()
    assert server.twin.counters["received"] == 1


def test_a_twin_serves_tcp_and_a_bus_at_once_and_each_hears_the_other():
    node, peer = (can.Bus(interface="virtual", channel="both") for _ in range(2))
    server = Server(Twin(TwinSettings(motion=motion_named("none"))))
    server.join(RawBus(node))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        flags = {"interface": "socketcand", "host": "127.0.0.1", "port": server.port, "channel": "can0"}
        with can.Bus(**flags, tcp_tune=True) as client:
            send(client, codec.get(10, 8))
            assert [each.arbitration_id for each in hear(peer, 2)] == [0x00A, 0x546]
            assert [each.arbitration_id for each in hear(client, 1)] == [0x546]
            send(peer, codec.get(10, 8))
            assert [each.arbitration_id for each in hear(client, 2)] == [0x00A, 0x546]
    finally:
        server.stop()
        thread.join()
        server.close()
        peer.shutdown()


def test_an_interface_that_fails_is_borne_for_a_second_and_then_given_up():
    driver = Scripted()
    bus = RawBus(driver)
    assert bus.descriptor is None
    driver.receive_error = can.CanOperationError("Network is down", 100)
    driver.send_error = can.CanOperationError("Network is down", 100)
    for _ in range(HOPELESS - 1):
        assert bus.hear() == []
    bus.say(Frame(0x546, b""))
    assert bus.refused == 1
    assert not bus.hopeless
    driver.receive_error = None
    driver.queue.extend([message(id=0x404, data=b"\x30"), message(), message(id=0x546)])  # the last two are robots'
    assert bus.hear() == [Frame(0x404, b"\x30")]
    driver.receive_error = OSError(19, "No such device")
    server = Server(Twin(TwinSettings(motion=motion_named("none"))), None)
    server.join(bus)
    driver.shutdown = lambda: None
    with closing(server):
        server.run(5.0)
        assert bus.hopeless
        assert server.twin.now < 4.0


def test_the_verb_takes_python_cans_flags(capsys):
    with can.Bus(interface="virtual", channel="verb") as peer:
        threading.Timer(0.5, lambda: send(peer, codec.get(10, 8))).start()
        before = signal.getsignal(signal.SIGTERM)
        code = main(["twin", "-i", "virtual", "-c", "verb", "--rhythm", "none", "--duration", "1.5"])
        assert code == 0
        assert signal.getsignal(signal.SIGTERM) is before
        assert [each.arbitration_id for each in hear(peer, 1)] == [0x546]
    said = capsys.readouterr().out
    assert "bus: -i virtual -c verb" in said
    assert "socketcand" not in said


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["-i", "socketcan", "-c", "nosuchcan"], 1, "cannot be opened"),
        (["-i", "virtual", "-c", "x", "--fd"], 2, "--fd = given: must be left out"),
        (["-i", "virtual", "-c", "x; y"], 2, "the name of a CAN channel"),
    ],
)
def test_a_bus_that_cannot_be_is_one_sentence(capsys, flags, code, says):
    assert main(["twin", *flags]) == code
    said = capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said
