"""`jaxmpc twin` as a process of its own, and what it refuses."""

import os
import re
import signal
import socket
import subprocess
import sys
import time

import can
import msgspec
import pytest

from deploy.puck import codec
from deploy.twin.scenario import EXPERIMENT
from jaxmpc import Experiment, cli

CODE = "import sys; from jaxmpc import cli; sys.exit(cli.main(sys.argv[1:]))"


@pytest.fixture
def start():
    running = []

    def started(*arguments):
        command = [sys.executable, "-u", "-c", CODE, "twin", "--port", "0", *arguments]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        running.append(process)
        told = b""
        while b"pendant:" not in told:
            line = process.stdout.readline()
            assert line, told
            told += line
        return process, told.decode()

    yield started
    for process in running:
        process.kill()
        process.communicate()


def connect(told):
    port = int(re.search(r"port=(\d+)", told)[1])
    return can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0", tcp_tune=True)


def mode(bus):
    bus.send(can.Message(arbitration_id=10, data=b"\x08", is_extended_id=False))
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        got = bus.recv(0.1)
        if got is not None and got.arbitration_id == 0x546:
            return codec.decode(codec.Frame(got.arbitration_id, bytes(got.data))).value
    raise AssertionError("no answer")


def test_it_says_what_it_is_serves_it_and_ends_with_statistics(start):
    process, told = start("--stiffness", "375", "--rhythm", "premature", "--fault", "J2:off@3+0.1", "--seed", "5")
    assert "elastic tissue, 375 N/m, holds the tip once touched; heart premature; seed 5" in told
    assert "J2: off from 3 s for 0.1 s" in told
    with connect(told) as bus:
        assert mode(bus) == 1
        process.stdin.write(b"a")
        process.stdin.flush()
        until = time.monotonic() + 10.0
        while mode(bus) != 2 and time.monotonic() < until:
            time.sleep(0.01)
        process.stdin.write(b"e\n")
        process.stdin.flush()
        until = time.monotonic() + 10.0
        while (now := mode(bus)) != 0 and time.monotonic() < until:
            time.sleep(0.01)
        assert now == 0
    process.send_signal(signal.SIGINT)
    rest = process.communicate(timeout=20)[0].decode()
    assert process.returncode == 0
    for word in ("safety module e-stop", "frames received", "ticks", "clients"):
        assert word in rest


def test_it_ends_after_its_duration_and_presses_the_button_itself(start):
    process, _ = start("--duration", "0.3", "--activate-after", "0.1")
    # Nobody drives: the safety module, active, misses its heartbeat.
    rest = process.communicate(timeout=20)[0].decode()
    assert process.returncode == 0
    assert "0.300 s; safety module idle" in rest


def test_a_terminate_ends_it_too(start):
    process, _ = start()
    process.terminate()
    assert "safety module idle" in process.communicate(timeout=20)[0].decode()
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--fault", "force:stuk"], "'stuck'"),
        (["--tissue", "elastik"], "'elastic'"),
        (["--rhythm", "waltz"], "rhythm"),
        (["--stiffness", "-1"], "stiffness"),
        (["--stiffness", "nan"], "stiffness"),
        (["--gap", "2"], "gap"),
        (["--duration", "-1"], "--duration"),
        (["--activate-after", "nan"], "--activate-after"),
        (["--port", "70000"], "--port"),
        (["--seed", "-1"], "seed"),
        (["--channel", "can0", "--duration", "0.1"], "--interface"),
        (["--bitrate", "500000", "--duration", "0.1", "--port", "0"], "1000000 bit/s"),
    ],
)
def test_wrong_input_is_a_sentence(arguments, word, capsys):
    assert cli.main(["twin", *arguments]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert error.count("\n") == 1


def test_the_keys_of_an_experiment_are_known_without_it():
    assert {field.name for field in msgspec.structs.fields(Experiment)} == set(EXPERIMENT)


def test_a_taken_port_is_a_failure(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert cli.main(["twin", "--port", str(taken.getsockname()[1])]) == 1
    assert "cannot listen" in capsys.readouterr().err


def test_slcan_needs_pyserial(monkeypatch, capsys):
    monkeypatch.setattr("deploy.twin.cli.find_spec", lambda name: None)
    assert cli.main(["twin", "--slcan"]) == 2
    assert "pyserial" in capsys.readouterr().err


def test_with_pyserial_slcan_is_a_pseudo_terminal(monkeypatch, capsys):
    monkeypatch.setattr("deploy.twin.cli.find_spec", lambda name: True)
    assert cli.main(["twin", "--port", "0", "--slcan", "--duration", "0.05"]) == 0
    name = re.search(r"-i slcan -c (\S+)", capsys.readouterr().out)[1]
    assert not os.path.exists(name) or os.path.dirname(name) == "/dev/pts"
