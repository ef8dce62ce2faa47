"""The controller as its own process on the twin's bus: killed, stopped, and flown for a minute."""

import hashlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import can
import pytest

from deploy.controller.file import to_bytes
from deploy.puck.codec import unpack_torques
from tests.deploy.made import arm_artifact

IDLE_PUCKS, IDLE_SAFETY = (0x404, bytes((0x88, 0, 0, 0, 0, 0))), (0x00A, bytes((0x88, 0, 1, 0, 0, 0)))
TORQUE = 0x401
SOON = 0.010
"""Within which the arm must be idle after its controller died [s], on a machine that nobody else uses."""
BEGINNINGS = 5
"""How often a controller may begin: where tests share two cores, cycles are missed, and replies are late."""


@contextmanager
def robot(*flags, listening=True):
    """A twin in real time as a process of its own, and a listener on its bus that stamps every frame, or none."""
    command = [
        sys.executable,
        "-m",
        "jaxmpc",
        "twin",
        "--port",
        "0",
        "--activate-after",
        "8",
        "--sensor-frame",
        "world",
    ]
    twin = subprocess.Popen([*command, *flags], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    port = next(int(found[1]) for line in twin.stdout if (found := re.search(r"port=(\d+)", line)))
    heard: list[tuple[float, int, bytes]] = []
    if not listening:
        try:
            yield port, heard, None
        finally:
            twin.terminate()
            twin.communicate(timeout=10.0)
        return
    bus = can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0", tcp_tune=True)
    done = threading.Event()

    def listen() -> None:
        while not done.is_set():
            if (got := bus.recv(0.05)) is not None:
                heard.append((time.monotonic(), got.arbitration_id, bytes(got.data)))

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        yield port, heard, bus
    finally:
        done.set()
        listener.join()
        bus.shutdown()
        twin.terminate()
        twin.communicate(timeout=10.0)


def safety_mode(heard, bus):
    """What the safety module answers when it is asked."""
    since = time.monotonic()
    bus.send(can.Message(arbitration_id=10, data=bytes((8,)), is_extended_id=False))
    replies: list[int] = []
    wait_for(
        lambda: replies.extend(data[2] for at, i, data in list(heard) if at > since and i == 0x546) or replies, 2.0
    )
    return replies[-1]


def controller(folder, port, *flags):
    """`jaxmpc run` on that bus, armed and with leave to start."""
    data = to_bytes(arm_artifact())
    path = folder / "controller.npz"
    path.write_bytes(data)
    bus = ["-i", "socketcand", "-c", "can0", "--bus-kwargs", "host=127.0.0.1", f"port={port}", "--"]
    command = [sys.executable, "-m", "jaxmpc", "run", *flags, "--arm", hashlib.sha256(data).hexdigest()]
    command += [
        "--start",
        "auto",
        "--sensor-frame",
        "world",
        "--no-tare",
        "-o",
        str(folder / "flights"),
        *bus,
        str(path),
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    return condition()


def driven(heard):
    return [at for at, number, data in list(heard) if number == TORQUE and len(data) == 8 and any(unpack_torques(data))]


@contextmanager
def driving(folder):
    """A twin, its bus and a controller that drives it. One that ended after missed cycles begins anew."""
    for _ in range(BEGINNINGS):
        with robot("--rhythm", "none") as (port, heard, bus):
            process = controller(folder, port)
            wait_for(lambda heard=heard, process=process: len(driven(heard)) > 20 or process.poll() is not None, 60.0)
            if process.poll() is None and len(driven(heard)) > 20:
                yield process, heard, bus
                return
            process.kill()
            output, _ = process.communicate()
        assert re.search("cycles missed [1-9]", output), output
    pytest.fail(f"late {BEGINNINGS} times in a row: {output}")


def idled(heard, since):
    """When both orders to idle had been heard [s]."""
    first = {}
    for at, number, data in list(heard):
        if at >= since and (number, data) in (IDLE_PUCKS, IDLE_SAFETY):
            first.setdefault(number, at)
    return max(first.values()) if len(first) == 2 else None


@pytest.mark.oracle
def test_a_killed_controller_leaves_an_idle_arm(tmp_path):
    with driving(tmp_path) as (process, heard, bus):
        process.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        assert wait_for(lambda: idled(heard, killed) is not None, 5.0)
        took = idled(heard, killed) - killed
        process.communicate()
        # Half of the cores serve the twin and its listener: the bar of 10 ms is for a machine of its own.
        assert safety_mode(heard, bus) == 1
    # Twin, listener and tests share the cores: the bar of 10 ms is for a machine of its own.
    assert took < 10.0 * SOON, f"{1e3 * took:.1f} ms"
    assert [at for at in driven(heard) if at > killed + took] == []


@pytest.mark.oracle
def test_a_stopped_controller_computes_nothing_from_what_is_old(tmp_path):
    with driving(tmp_path) as (process, heard, bus):
        process.send_signal(signal.SIGSTOP)
        stopped = time.monotonic()
        time.sleep(0.1)
        process.send_signal(signal.SIGCONT)
        output, _ = process.communicate(timeout=30.0)
        took = idled(heard, stopped) - stopped
        assert safety_mode(heard, bus) == 1
    assert took < 10.0 * SOON, f"{1e3 * took:.1f} ms"
    # A frame that was being sent when it was stopped is sent when it goes on, to idle pucks; no second one.
    assert len([at for at in driven(heard) if at > stopped + max(took, 0.09)]) <= 1
    assert process.returncode == 1
    assert "stalled" in output


@pytest.mark.slow
def test_a_minute_in_real_time_completes_or_says_that_it_was_late(tmp_path):
    with robot(listening=False) as (port, _, _):
        process = controller(tmp_path, port, "--duration", "60")
        output, _ = process.communicate(timeout=150.0)
    assert "cycles of 1000 µs wanted" in output
    if process.returncode == 0:
        assert "ended: stopped, finished" in output
    elif "ended: fault, stalled" in output:  # so late that the watchdog lowered the arm
        assert "watchdog: no beat for" in output or not re.search("cycles missed 0$", output, re.MULTILINE), output
    else:
        assert "late" in output.splitlines()[-1], output
    assert os.listdir(tmp_path / "flights") if process.returncode else True
