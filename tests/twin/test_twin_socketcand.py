"""The twin in real time behind TCP: python-can's own client, several at once, and whatever else may knock."""

import os
import socket
import threading
import time
import tty
from contextlib import closing

import can
import pytest

from deploy.bus.bus import Bus
from deploy.puck import codec, messages
from deploy.puck.frame import Frame
from deploy.twin.scenario import motion_named
from deploy.twin.server import HOST, Server
from deploy.twin.settings import TwinSettings
from deploy.twin.slcan import Slcan
from deploy.twin.socketcand import Socketcand
from deploy.twin.twin import Twin

P, STAT = 48, 5


@pytest.fixture
def serve():
    running = []

    def start(**settings):
        server = Server(Twin(TwinSettings(**{"motion": motion_named("none")} | settings)))
        thread = threading.Thread(target=server.run)
        running.append((server, thread))
        thread.start()
        return server

    yield start
    for server, thread in running:
        server.stop()
        thread.join()
        server.close()


def connect(server):
    return can.Bus(interface="socketcand", host=HOST, port=server.port, channel="can0", tcp_tune=True)


def message(frame):
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)


def hear(bus, count, seconds=5.0):
    """So many frames; a loaded machine may take its time."""
    frames, until = [], time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < until:
        got = bus.recv(0.1)
        if got is not None and not got.is_error_frame:
            frames.append(Frame(got.arbitration_id, bytes(got.data)))
    return frames


def test_python_cans_client_talks_to_the_pucks(serve):
    with connect(serve()) as bus:
        bus.send(message(codec.get(0x404, P)))
        bus.send(message(codec.get(8, 54)))
        found = [codec.decode(frame) for frame in hear(bus, 6)]
    assert [reply.node for reply in found[:4]] == [1, 2, 3, 4]
    assert [type(reply).__name__ for reply in found[4:]] == ["ForceReply", "MomentReply"]


def test_the_runtimes_own_bus_works_on_it(serve):
    bus = Bus(connect(serve()))
    bus.send(codec.get(10, 8))
    frame, _ = bus.receive(5.0)
    assert codec.decode(frame) == messages.PropertyReply(10, 8, 1)
    bus.close()


def test_every_client_sees_the_others_frames_and_all_replies(serve):
    server = serve()
    with connect(server) as controller, connect(server) as watchdog:
        # Each listens from its own first frame on, or after the pause behind the handshake.
        controller.send(message(codec.get(1, STAT)))
        assert hear(controller, 1) == [codec.encode_property(1, STAT, 2)]
        watchdog.send(message(codec.set_value(0x404, 8, 0)))
        assert hear(controller, 1) == [codec.set_value(0x404, 8, 0)]
        controller.send(message(codec.get(2, STAT)))
        assert hear(watchdog, 2)[-2:] == [codec.get(2, STAT), codec.encode_property(2, STAT, 2)]


def test_a_client_that_only_listens_hears_after_a_pause(serve):
    server = serve()
    with connect(server) as watchdog, connect(server) as controller:
        time.sleep(0.3)
        controller.send(message(codec.get(3, STAT)))
        assert hear(watchdog, 2) == [codec.get(3, STAT), codec.encode_property(3, STAT, 2)]


def test_a_client_that_goes_leaves_the_others_alone(serve):
    server = serve()
    for _ in range(3):
        connect(server).shutdown()
    with connect(server) as bus:
        bus.send(message(codec.get(1, STAT)))
        assert len(hear(bus, 1)) == 1
    assert server.counters["clients"] == 4


def test_it_listens_to_this_machine_alone_and_a_taken_port_is_an_error(serve):
    server = serve()
    assert server._listener.getsockname()[0] == "127.0.0.1"
    with pytest.raises(OSError, match="in use"):
        Server(Twin(TwinSettings(motion=motion_named("none"))), server.port)


def test_time_goes_by_as_on_the_clock(serve):
    """Whatever the load: ticks are caught up with, or counted as given up."""
    began = time.monotonic()
    server = serve()
    time.sleep(0.5)
    server.stop()
    ticks = server.counters["ticks"] + server.counters["milliseconds given up"]
    assert 0.3 < ticks * 1e-3 <= time.monotonic() - began + 0.002


def test_time_stands_still_where_it_lags_far_behind_the_clock():
    """A twin that has been stopped does not run after the clock, at many times its speed."""
    server = Server(Twin(TwinSettings(motion=motion_named("none"))), None)
    stalls = iter([0.3])
    began = time.monotonic()
    server.run(0.03, lambda twin: time.sleep(next(stalls, 0.0)))
    took = time.monotonic() - began
    server.close()
    assert server.counters["ticks"] == 30
    assert server.counters["milliseconds given up"] >= 250
    assert 1e-3 * (30 + server.counters["milliseconds given up"]) <= took + 0.002


def test_bus_off_is_an_error_frame_and_then_silence(serve):
    server = serve(faults=("bus:off@0.3",))
    bus = Bus(connect(server))
    bus.send(codec.get(1, STAT))
    assert bus.receive(5.0)[0] == codec.encode_property(1, STAT, 2)
    until = time.monotonic() + 5.0
    while bus.state == "active" and time.monotonic() < until:
        bus.receive(0.05)
    assert bus.state == "off"
    bus.close()


def test_nonsense_is_counted_and_does_no_harm(serve):
    server = serve()
    with closing(socket.create_connection((HOST, server.port))) as raw:
        assert raw.recv(64) == b"< hi >"
        raw.sendall(b"< open can0 >< rawmode >")
        for text in (
            b"< send 404 2 30 >",
            b"< send 1FFFFFFF 1 30 >",
            b"< send zz 1 30 >",
            b"< send 404 9 1 2 3 4 5 6 7 8 9 >",
            b"< send -1 0 >",
            b"< dance >",
            b">>>",
            b"x" * 10_000,
            b"< send 404 1 100 >",
        ):
            raw.sendall(text)
        raw.sendall(b"< send 00A 1 8 >< echo >")
        raw.settimeout(5.0)
        heard = b""
        while not heard.endswith(b"< echo >") and b"< echo >" not in heard:
            heard += raw.recv(4096)
        while b"frame 546" not in heard:
            heard += raw.recv(4096)
    assert heard.startswith(b"< ok >< ok >")
    assert b"88000100" in heard


def test_what_is_said_is_what_python_can_reads():
    frame = Frame(0x42A, bytes(range(8)))
    read = can.interfaces.socketcand.socketcand.convert_ascii_message_to_can_message(
        Socketcand().say(frame, 1.5).decode()
    )
    assert (read.arbitration_id, bytes(read.data), read.timestamp, read.is_extended_id) == (*frame, 1.5, False)
    written = can.interfaces.socketcand.socketcand.convert_can_message_to_ascii_message(message(frame))
    assert Socketcand().hear(written.encode(), 0.0) == ([frame], b"")


def test_frames_may_come_in_pieces():
    talk, frames = Socketcand(), []
    for byte in b"< send 404 1 30 >< send 001 1 5 >":
        frames += talk.hear(bytes((byte,)), 0.0)[0]
    assert frames == [codec.get(0x404, P), codec.get(1, STAT)]


# The serial adapter.


def test_slcan_opens_asks_and_answers_at_a_pseudo_terminal(serve):
    server = serve()
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    # Registered while the server runs: its loop takes a millisecond at most to see it.
    server.attach(os.fdopen(master, "rb", buffering=0), Slcan())
    os.write(slave, b"S8\rO\rt00A108\r")
    heard, until = b"", time.monotonic() + 5.0
    while b"t546" not in heard and time.monotonic() < until:
        heard += os.read(slave, 4096)
    assert heard == b"\r\rz\rt5466" + b"880001000000\r"
    os.close(slave)


def test_slcan_takes_frames_only():
    talk = Slcan()
    assert not talk.listens(0.0)
    assert talk.hear(b"O\rt4041", 0.0) == ([], b"\r")
    assert talk.listens(0.0)
    assert talk.hear(b"30\rt404230\rT1FFFFFFF0\rt9990\rV\r\r", 0.0) == ([codec.get(0x404, P)], b"z\r\a\a\aV1013\r")
    assert talk.malformed == 3
    assert talk.say(Frame(0x426, b"\x01\xff"), 0.0) == b"t426201FF\r"
    assert talk.hear(b"C\r", 0.0) == ([], b"\r")
    assert not talk.listens(0.0)


def test_python_cans_slcan_client_talks_to_the_pucks(serve):
    server = serve()
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    server.attach(os.fdopen(master, "rb", buffering=0), Slcan())
    with can.Bus(interface="slcan", channel=os.ttyname(slave), bitrate=1_000_000, sleep_after_open=0.1) as bus:
        bus.send(message(codec.get(0x404, P)))
        found = [codec.decode(frame) for frame in hear(bus, 4)]
    assert [reply.node for reply in found] == [1, 2, 3, 4]
    os.close(slave)
