"""The operator at the arm: messages shown and commands taken, without the loop ever waiting for either."""

import sys
import termios
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TextIO

from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.loop.signals import EndingSignals
from deploy.safety.machine import OperatingState, Task
from deploy.safety.reasons import EXPLANATION, Reason

CAPACITY = 1000
"""Lines that may wait for the terminal."""
_PAUSE = 0.02
_HELD_DOWN = 0.2
"""A key that is held down so long is one press [s]."""
_SAID = {
    OperatingState.ARMED: "armed: press Shift-activate on the pendant",
    OperatingState.APPROACH: "approach: going down until the tissue is met",
    OperatingState.CONTACT: "contact: the controller is in charge; {ends} ends it, a second Ctrl-C lets go",
    OperatingState.RETRACT: "retract",
    OperatingState.STOPPED: "stopped: held, then let go",
    OperatingState.FAULT: "FAULT",
}
_ENDS = {Task.OFF: "is let go", Task.RETRACT: "brakes and withdraws"}


class Console:
    """Prints from a thread of its own: a terminal that is slow, or stopped, must not stop the arm."""

    def __init__(self, out: TextIO | None = None) -> None:
        """Begin to write to a terminal or a file, standard output if none is given."""
        self._lines: deque[str] = deque(maxlen=CAPACITY)
        self._out, self._closing = out or sys.stdout, threading.Event()
        self._thread = threading.Thread(target=self._work, name="console", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Show a line, soon."""
        self._lines.append(line)

    def close(self) -> None:
        """Show what waits, for at most a second."""
        self._closing.set()
        self._thread.join(1.0)

    def _work(self) -> None:
        while True:
            closing = self._closing.wait(_PAUSE)
            try:
                while self._lines:
                    self._out.write(f"{self._lines.popleft()}\n")
                self._out.flush()
            except (OSError, ValueError):  # nobody reads any more: that must not stop the arm either
                return
            if closing:
                return


class Operator:
    """Operator commands, cycle by cycle, from keys, Ctrl-C and the end of the experiment."""

    def __init__(
        self,
        console: Console,
        signals: EndingSignals,
        contact_time: Callable[[], float],
        duration: float,
        start: bool,
        keys: bool,
    ) -> None:
        """Listen to keys.

        Args:
            console: Where changes are shown.
            signals: Entered; the first asks for the end, the second lets go.
            contact_time: How long the law has been in control [s].
            duration: When that is enough [s].
            start: Whether the approach begins by itself once the pendant has activated.
            keys: Whether Enter on standard input lets it begin, and then ends it.
        """
        self._console, self._signals, self._contact_time, self._duration = console, signals, contact_time, duration
        self._start, self._stop, self._ends = start, False, "Enter or Ctrl-C" if keys else "Ctrl-C"
        self._shown: tuple[OperatingState, Reason] | None = None
        self._tasks: set[Task] = set()
        self._state = OperatingState.IDLE
        if keys:
            _forget_typed()
            threading.Thread(target=self._listen, name="keys", daemon=True).start()

    @property
    def command(self) -> OperatorCommand:
        """Command of the operator at this moment."""
        if self._stop or self._signals.count:
            return OperatorCommand(True, self._start, Reason.OPERATOR, self._signals.count > 1)
        return OperatorCommand(
            True, self._start, Reason.FINISHED if self._contact_time() >= self._duration else Reason.NONE
        )

    def each(self, result: CycleResult) -> OperatorCommand:
        """Show a changed state, reason or task; return the operator's command."""
        now = result.safety_state
        if (now.state, now.reason) != self._shown:
            self._shown, self._state = (now.state, now.reason), now.state
            self._tasks.clear()
        # Positions that come and go change the task many times a second: each is news once.
        if result.task not in self._tasks:
            self._tasks.add(result.task)
            self._console.say(_line(result, self._ends))
        return self.command

    def _listen(self) -> None:
        for _ in _lines():
            if self._state in (OperatingState.IDLE, OperatingState.ARMED) and not self._start:
                self._start = True
                self._console.say("Enter: the approach begins once the pendant has activated the arm")
            elif self._state not in (OperatingState.IDLE, OperatingState.ARMED):
                self._stop = True
            time.sleep(_HELD_DOWN)
            _forget_typed()
        self._console.say("standard input has ended: Enter is not heard any more, Ctrl-C ends the run")


def _lines() -> Iterator[str]:
    """Lines that are typed, until nobody can type any more: a terminal goes on after Ctrl-D, a file does not."""
    while sys.stdin is not None:
        try:
            line = sys.stdin.readline()
            if not line and not sys.stdin.isatty():
                return
        except (OSError, ValueError):  # the terminal is gone
            return
        if line:
            yield line
        else:
            time.sleep(_HELD_DOWN)


def _forget_typed() -> None:
    """An Enter that was typed before it meant anything, or by a key that is held down, must neither begin nor end."""
    with suppress(OSError, ValueError, termios.error):  # the terminal is gone
        if sys.stdin is not None and sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _line(result: CycleResult, ends: str) -> str:
    now = result.safety_state
    text = _SAID.get(now.state, str(now.state)).format(ends=ends)
    if now.reason is not Reason.NONE:
        text += f" ({now.reason}{': ' + now.detail if now.detail else ''}): {EXPLANATION[now.reason]}"
    if now.state is OperatingState.FAULT:
        text += f" The arm {_ENDS.get(result.task, 'is held against gravity')}."
    return text
