"""What the operator commands by keys, signals and the end of the experiment."""

import io
import os
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from deploy.cli.run import _armed, _keys
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


@pytest.mark.parametrize("keys", [True, False])
def test_only_where_enter_is_heard_it_is_said_to_end_the_contact(keys, monkeypatch):
    said = []
    monkeypatch.setattr(operator_module.sys, "stdin", None)
    operator = Operator(SimpleNamespace(say=said.append), SimpleNamespace(count=0), lambda: 0.0, 10.0, True, keys)
    operator.each(SimpleNamespace(safety_state=SafetyState(OperatingState.CONTACT), task=Task.CONTROL))
    (line,) = (each for each in said if each.startswith("contact"))
    assert ("Enter" in line) == keys
    assert "Ctrl-C ends it" in line


@pytest.mark.parametrize(
    ("typed", "heard"),
    [
        ({}, True),
        ({"start": "auto"}, True),  # nobody need type it, and who sits there ends the run by it all the same
        ({"reference": "-"}, False),
        ({"start": "auto", "reference": "-"}, False),
        ({"lockstep": True}, False),
        ({"start": "auto", "terminal": False}, False),  # lines of a script are no hand
        ({"terminal": False}, True),
    ],
)
def test_enter_is_heard_where_a_hand_may_be(typed, heard, monkeypatch):
    said = {"start": "enter", "reference": "0,0,-5", "lockstep": False, "terminal": True} | typed
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: said["terminal"]))
    assert _keys(SimpleNamespace(**said)) == heard


@pytest.mark.parametrize("held", [True, False])
def test_a_key_that_is_held_down_begins_and_does_not_end_at_once(held, monkeypatch):
    master, slave = os.openpty()
    try:
        with os.fdopen(slave) as terminal:
            monkeypatch.setattr(operator_module.sys, "stdin", terminal)
            if not held:
                monkeypatch.setattr(operator_module, "_HELD_DOWN", 0.0)
            operator = made(start=False, keys=True)
            os.write(master, b"\n")
            begun(operator)
            operator.each(SimpleNamespace(safety_state=SafetyState(OperatingState.APPROACH), task=Task.APPROACH))
            if not held:
                time.sleep(0.05)
            os.write(master, b"\n")
            time.sleep(0.05 if not held else operator_module._HELD_DOWN + 0.1)
            assert operator.command.finish == (Reason.NONE if held else Reason.OPERATOR)
            listened_out(master)
    finally:
        os.close(master)


def test_a_task_that_comes_and_goes_is_told_once():
    said = []
    operator = Operator(SimpleNamespace(say=said.append), SimpleNamespace(count=0), lambda: 0.0, 10.0, True, False)
    old, late = (SafetyState(OperatingState.FAULT, reason) for reason in (Reason.POSITION_OLD, Reason.LATE))
    for now in (old, late):
        for task in (Task.GRAVITY, Task.RETRACT) * 50:
            operator.each(SimpleNamespace(safety_state=now, task=task))
    operator.each(SimpleNamespace(safety_state=late._replace(let_go=True), task=Task.OFF))
    ends = ["held against gravity.", "brakes and withdraws."] * 2 + ["let go."]
    assert all(line.endswith(end) for line, end in zip(said, ends, strict=True))


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
            begun(operator)
            listened_out(master)
    finally:
        os.close(master)


def begun(operator):
    """The operator's Enter is heard, within some seconds."""
    end = time.monotonic() + 10.0
    while not operator.command.start and time.monotonic() < end:
        time.sleep(0.01)
    assert operator.command.start


def listened_out(master):
    """The terminal is gone, and with it who listens to it."""
    other, _ = os.openpty()
    os.dup2(other, master)
    os.close(other)
    for thread in threading.enumerate():
        if thread.name == "keys":
            thread.join(10.0)
            assert not thread.is_alive()


def test_a_ctrl_d_is_no_end_of_listening(monkeypatch):
    """It is the end of a file, not of a terminal: Enter still begins and ends."""
    master, slave = os.openpty()
    try:
        with os.fdopen(slave) as terminal:
            monkeypatch.setattr(operator_module.sys, "stdin", terminal)
            operator = made(start=False, keys=True)
            for typed in (b"\x04", b"\x04", b"\n"):
                time.sleep(0.3)
                os.write(master, typed)
            begun(operator)
            listened_out(master)
    finally:
        os.close(master)


def gone():
    raise OSError(5, "Input/output error")


@pytest.mark.parametrize("stdin", [None, io.StringIO(""), SimpleNamespace(readline=gone)], ids=["none", "end", "gone"])
def test_who_has_no_standard_input_arms_nothing(monkeypatch, stdin):
    monkeypatch.setattr(sys, "stdin", stdin)
    assert not _armed(None, 64 * "0")


@pytest.mark.parametrize("stdin", [None, io.StringIO("")], ids=["closed", "ended"])
def test_where_nobody_can_type_it_is_said(monkeypatch, stdin):
    said = []
    monkeypatch.setattr(operator_module.sys, "stdin", stdin)
    operator = Operator(SimpleNamespace(say=said.append), SimpleNamespace(count=0), lambda: 0.0, 10.0, False, False)
    operator._listen()
    assert said == ["standard input has ended: Enter is not heard any more, Ctrl-C ends the run"]
    assert operator.command == OperatorCommand(True, False)
