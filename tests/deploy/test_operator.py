"""What the operator commands by keys, signals and the end of the experiment."""

import io
import os
import threading
import time
from types import SimpleNamespace

import pytest

from deploy.loop import operator as operator_module
from deploy.loop.cycle import OperatorCommand
from deploy.loop.operator import Operator
from deploy.safety.machine import OperatingState, SafetyState, Task
from deploy.safety.reasons import Reason

BEFORE = (OperatingState.IDLE, OperatingState.ARMED)


def made(signals=0, contact=0.0, start=True, keys=False):
    console = SimpleNamespace(say=lambda line: None)
    return Operator(console, SimpleNamespace(count=signals), lambda: contact, 10.0, start, keys)


@pytest.mark.parametrize(
    ("signals", "contact", "command"),
    [
        (0, 9.99, OperatorCommand(True, True, Reason.NONE, False)),
        (0, 10.0, OperatorCommand(True, True, Reason.FINISHED, False)),
        (1, 10.0, OperatorCommand(True, True, Reason.OPERATOR, False)),
        (2, 0.0, OperatorCommand(True, True, Reason.OPERATOR, True)),
        (3, 0.0, OperatorCommand(True, True, Reason.OPERATOR, True)),
    ],
)
def test_the_first_signal_asks_for_the_end_and_the_second_lets_go(signals, contact, command):
    assert made(signals, contact).command == command


@pytest.mark.parametrize("state", OperatingState)
def test_enter_begins_the_approach_and_later_ends_whatever_moves(state, monkeypatch):
    operator = made(start=False)
    operator.each(SimpleNamespace(safety_state=SafetyState(state), task=Task.HOLD))
    monkeypatch.setattr(operator_module.sys, "stdin", io.StringIO("\n"))
    monkeypatch.setattr(operator_module.time, "sleep", lambda seconds: None)
    operator._listen()
    ends = Reason.NONE if state in BEFORE else Reason.OPERATOR
    assert operator.command == OperatorCommand(True, state in BEFORE, ends, False)


def test_a_second_enter_before_the_approach_ends_nothing(monkeypatch):
    operator = made(start=False)
    monkeypatch.setattr(operator_module.sys, "stdin", io.StringIO("\n\n"))
    monkeypatch.setattr(operator_module.time, "sleep", lambda seconds: None)
    operator._listen()
    assert operator.command == OperatorCommand(True, True)


def test_an_enter_from_before_it_was_asked_for_begins_nothing(monkeypatch):
    master, slave = os.openpty()
    try:
        os.write(master, b"\n\n")
        with os.fdopen(slave) as terminal:
            monkeypatch.setattr(operator_module.sys, "stdin", terminal)
            operator = made(start=False, keys=True)
            time.sleep(0.3)
            assert not operator.command.start
            os.write(master, b"\n")
            end = time.monotonic() + 10.0
            while not operator.command.start and time.monotonic() < end:
                time.sleep(0.01)
            assert operator.command.start
            os.write(master, b"\x04")  # the end of what is typed, and of who listens
            for thread in threading.enumerate():
                if thread.name == "keys":
                    thread.join(10.0)
    finally:
        os.close(master)
