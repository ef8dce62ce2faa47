"""More connections than the twin's server can bear, or has descriptors for: it serves on."""

import re
import resource
import socket
import subprocess
import sys
import time

import can
import pytest

from deploy.twin.server import MOST_CLIENTS

CODE = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]), resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
from jaxmpc import cli
sys.exit(cli.main(sys.argv[2:]))
"""
"""The twin with so many descriptors: it sets its limit itself, since a fork under JAX's threads may hang."""


@pytest.fixture
def start():
    running = []

    def started(descriptors):
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", CODE, str(descriptors), "twin", "--port", "0", "--rhythm", "none"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        running.append(process)
        port = next(int(found[1]) for line in process.stdout if (found := re.search(r"port=(\d+)", line)))
        return process, port

    yield started
    for process in running:
        process.kill()
        process.communicate()


CLIENT = """
import can, sys, time
with can.Bus(interface="socketcand", host="127.0.0.1", port=int(sys.argv[1]), channel="can0", tcp_tune=True) as bus:
    bus.send(can.Message(arbitration_id=10, data=bytes([8]), is_extended_id=False))
    until = time.monotonic() + 10.0
    while (got := bus.recv(0.1)) is None or got.arbitration_id != 0x546:
        assert time.monotonic() < until
    print(got.data[2])
"""
"""python-can's client in a process of its own: it waits by select, which bears no descriptor above 1023."""


def mode(port):
    """What the safety module answers."""
    done = subprocess.run([sys.executable, "-c", CLIENT, str(port)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


@pytest.mark.parametrize(("connections", "descriptors"), [(1100, 4096), (1100, 256), (200, 24)])
def test_idle_connections_do_not_end_the_twin_nor_keep_a_client_out(start, connections, descriptors):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, connections + 500), hard))
    idle = []
    try:
        process, port = start(min(descriptors, hard))
        for _ in range(connections):
            idle.append(socket.create_connection(("127.0.0.1", port), timeout=10.0))
        assert mode(port) == 1
        process.terminate()
        said, _ = process.communicate(timeout=20.0)
        assert process.returncode == 0, said
        assert "Traceback" not in said
        assert int(re.search(r"clients refused +(\d+)", said)[1]) >= connections - MOST_CLIENTS - 1
    finally:
        for each in idle:
            each.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_clients_that_have_spoken_are_not_put_out_by_a_crowd(start):
    _, port = start(4096)
    with can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0", tcp_tune=True) as first:
        crowd = [socket.create_connection(("127.0.0.1", port), timeout=10.0) for _ in range(3 * MOST_CLIENTS)]
        first.send(can.Message(arbitration_id=10, data=b"\x08", is_extended_id=False))
        until = time.monotonic() + 10.0
        while (got := first.recv(0.1)) is None or got.arbitration_id != 0x546:
            assert time.monotonic() < until
        for each in crowd:
            each.close()
