r"""Ctrl-C and SIGTERM: the first asks, the second lets go, and after it the process ends whatever hangs.

Ctrl-Z and Ctrl-\ are meant for programs that may be stopped, or killed, at any moment: here they ask like Ctrl-C, for a
stopped loop lets the arm fall. Nor does it stop for a terminal whose background it is in.

A terminal that is closed, as by a connection that breaks, asks too. It may say so twice, by the shell and by the
kernel: that lets nothing go. Who had it ignored before, by nohup, flies on.

What ends it then is SIGALRM with the system's own action: no lock, no disk and no loop of this program can hold it up.
The watchdog sees the pipe close, as with any other death of the controller.
"""

import signal
from types import FrameType, TracebackType
from typing import Any

GRACE = 1.0
"""Time after the second signal in which the arm is let go and the recording written [s]; then the process ends."""
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP, signal.SIGQUIT)
BACKGROUND = (signal.SIGTTIN, signal.SIGTTOU)


class EndingSignals:
    """Counts signals that ask for the end, while it is entered.

    Attributes:
        count: How many have come since the loop began.
    """

    def __init__(self) -> None:
        """Count from zero."""
        self.count = 0
        self._flying = False
        self._before: dict[signal.Signals, Any] = {}

    def begin(self) -> None:
        """The loop begins: from now on the first signal asks it to end; until now it ends the program at once."""
        self._flying = True

    def __enter__(self) -> "EndingSignals":
        for number in ENDING:
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._heard)
        for number in BACKGROUND:
            self._before[number] = signal.signal(number, signal.SIG_IGN)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP and self.count:
            return
        self.count += 1
        if self.count == 2:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.setitimer(signal.ITIMER_REAL, GRACE)
        if not self._flying:
            raise KeyboardInterrupt
