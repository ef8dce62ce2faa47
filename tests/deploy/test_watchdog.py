"""The watchdog process against a bus that another process could reach: a few lines of socketcand."""

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from argparse import ArgumentParser, Namespace

import can
import pytest
from can.cli import add_bus_arguments

from deploy.loop import watchdog_process
from deploy.loop.beats import BeatPage
from deploy.loop.signals import ENDING
from deploy.loop.watchdog import Watchdog, WatchdogError, bus_flags
from deploy.loop.watchdog_process import IDLE_FRAMES, SOCKET, overdue
from deploy.puck.codec import GROUPS, SAFETY_MODULE, decode
from deploy.puck.frame import Frame
from deploy.puck.messages import Set

MS = 1_000_000
SLACK = 0.25
"""How much later than on a quiet machine something may happen on a loaded one [s]."""


class Server:
    """A bus with one listener: keeps every frame sent to it, with the time."""

    def __init__(self):
        self.frames = []
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.flags = ["--interface", "socketcand", "--channel", "can0", "--bus-kwargs", "host=127.0.0.1"]
        self.flags += [f"port={self.listening.getsockname()[1]}", "tcp_tune=True"]
        self.connection = None
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        try:
            self.connection, _ = self.listening.accept()
            self.connection.sendall(b"< hi >")
            text = ""
            while data := self.connection.recv(4096):
                now = time.monotonic()
                *commands, text = (text + data.decode()).split(">")
                for command in commands:
                    word, *rest = command.strip("< ").split()
                    if word == "send":
                        self.frames.append((now, int(rest[0], 16), bytes(int(byte, 16) for byte in rest[2:])))
                    else:
                        self.connection.sendall(b"< ok >")
        except OSError:
            pass

    def babble(self, count):
        frame = b"< frame 423 0.000000 000002 >"
        self.connection.sendall(count * frame)

    def wait(self, count=1, within=10.0):
        end = time.monotonic() + within
        while len(self.frames) < count and time.monotonic() < end:
            time.sleep(0.002)
        return self.frames

    def close(self):
        self.listening.close()
        if self.connection:
            self.connection.close()


@pytest.fixture
def server():
    server = Server()
    yield server
    server.close()


@pytest.mark.parametrize(
    ("beat", "now", "closed", "acts"),
    [
        (0, 99 * MS, True, False),
        (-1 * MS, 99 * MS, True, False),
        (-1 * MS, 99 * MS, False, False),
        (10 * MS, 10 * MS, True, True),
        (10 * MS, 15 * MS, False, False),
        (10 * MS, 15 * MS + 1, False, True),
        (10 * MS, 9 * MS, False, False),
    ],
)
def test_when_it_acts(beat, now, closed, acts):
    assert bool(overdue(beat, now, 5 * MS, closed)) == acts


def test_a_stop_of_beats_lowers_the_arm_once_and_for_good(server):
    with Watchdog(server.flags, timeout_ms=5.0) as watchdog:
        watchdog.beat(time.monotonic_ns(), True)
        last = time.monotonic()
        frames = server.wait(12)
        assert watchdog.fired
        assert [(number, data) for _, number, data in frames] == [*IDLE_FRAMES] * 6
        assert 0.005 <= frames[0][0] - last < 0.010 + SLACK
        watchdog.beat(time.monotonic_ns(), True)
        assert watchdog.fired
        assert watchdog.answers(time.monotonic_ns())
        time.sleep(0.05)
        assert len(server.frames) == 12


def test_it_stays_quiet_while_beats_come_and_after_a_clean_end(server):
    with Watchdog(server.flags, timeout_ms=500.0) as watchdog:
        for _ in range(100):
            watchdog.beat(time.monotonic_ns(), True)
            time.sleep(0.002)
        server.babble(2000)
        watchdog.beat(time.monotonic_ns(), True)
        assert watchdog.answers(time.monotonic_ns())
        watchdog.beat(time.monotonic_ns(), False)
        time.sleep(0.6)
        assert not watchdog.fired
    assert server.frames == []
    assert watchdog._process.returncode == 0
    watchdog.close()


def fails(server, torques_on):
    with Watchdog(server.flags, timeout_ms=5000.0) as watchdog:
        watchdog.beat(time.monotonic_ns(), torques_on)
        raise IndexError


def test_a_program_that_fails_with_torques_on_leaves_the_arm_to_it(server):
    with pytest.raises(IndexError):
        fails(server, torques_on=True)
    assert [(number, data) for _, number, data in server.wait(12)] == [*IDLE_FRAMES] * 6


def test_a_program_that_fails_after_letting_go_needs_it_no_more(server):
    with pytest.raises(IndexError):
        fails(server, torques_on=False)
    assert server.frames == []


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2, reason="one processor")
def test_it_does_not_share_the_only_processor_of_the_loop(server):
    before = os.sched_getaffinity(0)
    own = min(before)
    os.sched_setaffinity(0, {own})
    try:
        with Watchdog(server.flags, processors=before - {own}) as watchdog:
            assert os.sched_getaffinity(watchdog._process.pid) == before - {own}
    finally:
        os.sched_setaffinity(0, before)


def test_unarmed_it_stays_quiet_whatever_happens(server):
    watchdog = Watchdog(server.flags)
    time.sleep(0.05)
    os.close(watchdog._pipe)  # as if killed before the first torque
    assert watchdog._process.wait(5.0) == 0
    watchdog._pipe = None
    assert server.frames == []


CONTROLLER = """
import sys, time
from deploy.loop.watchdog import Watchdog
watchdog = Watchdog(sys.argv[2:], timeout_ms=float(sys.argv[1]))
while True:
    # as the loop does: what the watchdog has done is looked at before anything else
    if watchdog.fired:
        print("fired", flush=True)
        break
    watchdog.beat(time.monotonic_ns(), True)
    if "started" not in globals():
        started = print("beating", flush=True)
    time.sleep(0.001)
time.sleep(60)
"""


@pytest.fixture
def controller(server, request):
    command = [sys.executable, "-c", CONTROLLER, request.param, *server.flags]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "beating\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize("controller", ["10000"], indirect=True)  # the closed pipe alone must be enough
def test_kill_of_the_controller(server, controller):
    controller.kill()
    killed = time.monotonic()
    frames = server.wait(2)
    assert [(number, data) for _, number, data in frames[:2]] == [*IDLE_FRAMES]
    assert frames[0][0] - killed < 0.010 + SLACK


@pytest.mark.parametrize("controller", ["5"], indirect=True)
def test_a_stopped_controller_finds_out_before_its_first_cycle(server, controller):
    controller.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    frames = server.wait(2)
    assert [(number, data) for _, number, data in frames[:2]] == [*IDLE_FRAMES]
    assert frames[0][0] - stopped < 0.010 + SLACK
    controller.send_signal(signal.SIGCONT)
    assert controller.stdout.readline() == "fired\n"


WRITER = """
import sys, time
from deploy.loop import watchdog_process
from deploy.loop.beats import BeatPage
page, end = BeatPage(int(sys.argv[1])), time.monotonic() + 1.0
while time.monotonic() < end:
    for number in range(1, 1000):
        page.alive = page.beat = number << 32 | number
"""


def test_what_asks_the_controller_to_end_does_not_end_its_watchdog(server):
    """A terminal, or a service that is stopped, may say so to every process of the run: it still has to withdraw."""
    with Watchdog(server.flags, timeout_ms=500.0) as watchdog:
        assert os.getsid(watchdog._process.pid) != os.getsid(0)
        for number in ENDING:
            os.kill(watchdog._process.pid, number)
        time.sleep(0.05)
        asked = time.monotonic_ns()
        time.sleep(0.05)
        assert watchdog._process.poll() is None
        assert watchdog._page.alive > asked
    assert watchdog._process.returncode == 0
    assert server.frames == []


def test_no_time_is_read_half_written():
    descriptor = BeatPage.create()
    page = BeatPage(descriptor)
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(descriptor)], pass_fds=(descriptor,))
    os.close(descriptor)
    while not page.beat:
        pass
    seen = set()
    while writer.poll() is None:
        for _ in range(10_000):
            seen.add(page.alive)
            seen.add(page.beat)
    assert len(seen) > 1  # both ran at the same time
    assert all(number >> 32 == number & 0xFFFFFFFF > 0 for number in seen)


def test_the_socket_of_pythons_socketcand_client_is_where_it_is_looked_for(server):
    bus = can.Bus(interface="socketcand", host="127.0.0.1", port=server.listening.getsockname()[1], channel="can0")
    try:
        assert isinstance(getattr(bus, SOCKET), socket.socket)
    finally:
        bus.shutdown()


def test_without_a_bus_there_is_no_watchdog(capfd):
    with pytest.raises(WatchdogError, match="ended at once"):
        Watchdog(["--interface", "slcan", "--channel", "/dev/none"])
    assert "cannot open the bus" in capfd.readouterr().err


def test_bus_flags_survive_a_second_parsing():
    parser = ArgumentParser()
    add_bus_arguments(parser)
    line = "-i socketcand -c can0 -b 1000000 --fd --bus-kwargs host=127.0.0.1 port=29536 --timing f_clock=8000000"
    line += " tseg1=5 tseg2=2 sjw=2 brp=1 nof_samples=1"
    args = parser.parse_args(line.split())
    again = parser.parse_args(bus_flags(args))
    assert vars(again) == vars(args)
    assert bus_flags(Namespace()) == []


def test_a_beat_costs_the_loop_little(server):
    with Watchdog(server.flags, timeout_ms=1000.0) as watchdog:
        took = []
        for _ in range(2000):
            start = time.perf_counter_ns()
            watchdog.beat(start, False)
            took.append(time.perf_counter_ns() - start)
    # 1 µs; ten times that on a loaded machine, and still nothing of a cycle
    assert sorted(took)[1000] < 10_000


def test_the_timeout_of_the_command_line_is_in_milliseconds(monkeypatch):
    watched = []
    monkeypatch.setattr(watchdog_process, "watch", lambda page, pipe, timeout_ns, *bus: watched.append(timeout_ns))
    monkeypatch.setattr(watchdog_process, "prepare", lambda priority: None)
    page, ours, theirs = BeatPage.create(), *os.pipe()
    before = {number: signal.getsignal(number) for number in ENDING}
    try:
        flags = ["--page", f"{page}", "--pipe", f"{ours}", "--timeout-ms", "7.5"]
        assert watchdog_process.main([*flags, "--interface", "virtual", "--channel", "of-a-watchdog"]) == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        logging.disable(logging.NOTSET)
        for descriptor in (page, ours, theirs):
            os.close(descriptor)
    assert watched == [7_500_000]


def test_what_it_sends_lowers_the_state_of_pucks_and_safety_module():
    orders = [decode(Frame(number, data)) for number, data in IDLE_FRAMES]
    assert orders == [Set(GROUPS["wam"], 8, 0), Set(SAFETY_MODULE, 8, 1)]


def test_it_says_that_it_acts_before_it_sends_and_a_bus_that_refuses_is_tried_to_the_end(monkeypatch):
    page, ours, theirs = BeatPage.create(), *os.pipe()
    held, fired = BeatPage(page), []

    def refuse(message):
        fired.append(held.fired)
        raise OSError("full")

    monkeypatch.setattr(watchdog_process, "_say", lambda text: None)
    held.beat = 1
    os.close(theirs)
    watchdog_process.watch(held, ours, 5 * MS, Namespace(send=refuse, recv=lambda timeout: None), dict)
    for descriptor in (page, ours):
        os.close(descriptor)
    assert len(fired) == 12
    assert all(fired)


def test_who_has_not_looked_for_a_tenth_of_a_second_does_not_answer(server):
    with Watchdog(server.flags, timeout_ms=500.0) as watchdog:
        os.kill(watchdog._process.pid, signal.SIGSTOP)
        time.sleep(0.05)
        looked = watchdog._page.alive
        assert watchdog.answers(looked + 100 * MS - 1)
        assert not watchdog.answers(looked + 100 * MS)
        os.kill(watchdog._process.pid, signal.SIGCONT)
