"""The robot's guide says what the program does."""

import argparse
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

from deploy.doctor import Traffic
from deploy.loop.watchdog_process import IDLE_FRAMES
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from jaxmpc.cli import VERBS

GUIDE = (Path(__file__).parents[2] / "docs" / "robot.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^(?:`)?jaxmpc ([^`\n]+)", GUIDE, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_understood(command):
    verb, *words = shlex.split(command)
    assert verb in VERBS
    parser = argparse.ArgumentParser()
    import_module(VERBS[verb].module).configure(parser)
    parser.parse_args(words[: words.index("looks")] if "looks" in words else words)


def test_there_are_commands():
    assert {shlex.split(command)[0] for command in COMMANDS} >= {"freeze", "check", "run", "twin", "replay", "doctor"}


def rows(title):
    """Cells of the first table of a section."""
    section = GUIDE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    table = re.findall(r"^\|(.*)\|$", section, re.MULTILINE)
    return [[cell.strip() for cell in row.split("|")] for row in table[2:]]


def test_every_state_and_every_reason_is_explained():
    assert [row[0].strip("`") for row in rows("States")] == list(OperatingState)
    named = [word for row in rows("What each stop means") for word in re.findall(r"`([a-z-]+)`", row[0])]
    assert sorted(named) == sorted(Reason)


def test_what_lets_the_arm_go_is_said_so():
    for words, _, arm, _ in rows("What each stop means"):
        for word in re.findall(r"`([a-z-]+)`", words):
            assert ("lets go" in arm) >= Reason(word).lets_go, word


def test_the_watchdogs_frames_are_those_it_sends():
    frames = [(int(row[0], 16), bytes.fromhex(row[1])) for row in rows("The watchdog")]
    assert frames == [*IDLE_FRAMES]


def test_the_budget_is_the_doctors():
    told = [(int(row[1].split()[0]), int(row[2].split()[0])) for row in rows("Wiring")]
    wanted = [Traffic(4, False), Traffic(4, True), Traffic(4, True, 1.0), Traffic(7, False)]
    assert told == [(traffic.microseconds, round(traffic.highest_rate)) for traffic in wanted]
