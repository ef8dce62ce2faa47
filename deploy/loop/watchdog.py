"""The watchdog as the controller sees it: started, beaten once per cycle, asked whether it lives.

What the process does stands in `deploy.loop.watchdog_process`; between the two are a page of memory and a pipe, which
closes when the controller is gone, however it died.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence, Set
from contextlib import suppress
from types import TracebackType

from deploy.loop.beats import BeatPage

TIMEOUT_MS = 5.0
"""Age of the last beat at which it acts [ms]."""
_STALE_NS = 100_000_000
"""Age of its last look at which it counts as dead [ns]."""


class WatchdogError(ValueError):
    """No watchdog stands by; the message is a sentence that says why."""


class Watchdog:
    """The controller's end of the watchdog."""

    def __init__(
        self,
        bus_flags: Sequence[str],
        timeout_ms: float = TIMEOUT_MS,
        ready_within: float = 15.0,
        processors: Set[int] = frozenset(),
    ) -> None:
        """Start the process and wait until it stands by.

        Args:
            bus_flags: The flags of the bus (`can.cli`), as the controller's own command line had them.
            timeout_ms: Age of the last beat at which it acts [ms].
            ready_within: Patience for its start [s].
            processors: On which it runs; none for those of the controller, which may keep itself to a single one.

        Raises:
            WatchdogError: It did not start, or cannot open its bus.
        """
        page = BeatPage.create()
        self._page = BeatPage(page)
        ours, theirs = os.pipe()[::-1]
        command = [sys.executable, "-m", "deploy.loop.watchdog_process", "--page", str(page), "--pipe", str(theirs)]
        command += ["--timeout-ms", f"{timeout_ms:g}", *bus_flags]
        try:
            # A session of its own: what a terminal sends to the controller must not reach it.
            self._process = subprocess.Popen(
                command, pass_fds=(page, theirs), stdin=subprocess.DEVNULL, start_new_session=True
            )
        except OSError as error:
            os.close(ours)
            raise WatchdogError(f"the watchdog did not start: {error.strerror}") from None
        finally:
            os.close(page)
            os.close(theirs)
        self._pipe: int | None = ours
        if processors:
            with suppress(OSError):  # it has ended already, which is told below
                os.sched_setaffinity(self._process.pid, processors)
        end = time.monotonic() + ready_within
        while not self._page.alive:
            if self._process.poll() is not None:
                self.close()
                raise WatchdogError("the watchdog ended at once; its reason stands above")
            if time.monotonic() > end:
                self._process.kill()
                self.close()
                raise WatchdogError(f"the watchdog does not stand by after {ready_within:g} s: is the bus there?")
            time.sleep(0.005)

    def beat(self, now: int, torques_on: bool) -> None:
        """Say that the controller lives; once per cycle.

        Args:
            now: `time.monotonic_ns()`.
            torques_on: Whether a silence from now on is an accident.
        """
        self._page.beat = now if torques_on else -now

    @property
    def fired(self) -> bool:
        """Whether the watchdog has acted; then it stays so, and no torque may be sent."""
        return self._page.fired != 0

    def answers(self, now: int) -> bool:
        """Whether the watchdog has itself looked within the last 100 ms of `time.monotonic_ns()`; else stop."""
        return now - self._page.alive < _STALE_NS

    def close(self, stand_down: bool = True) -> None:
        """End it; safe to call again.

        Args:
            stand_down: Whether the arm has been let go for certain; else it lowers the arm if the last beat had torques
                on, as if the controller had died.
        """
        if self._pipe is None:
            return
        if stand_down:
            self._page.beat = -time.monotonic_ns()
        os.close(self._pipe)
        self._pipe = None
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> "Watchdog":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(stand_down=error is None)


def bus_flags(args: argparse.Namespace) -> list[str]:
    """The flags that `can.cli.add_bus_arguments` would parse into what it did parse, for a second process."""
    flags = []
    for name in ("channel", "interface", "bitrate", "data_bitrate"):
        if name in args:
            flags += [f"--{name.replace('_', '-')}", str(getattr(args, name))]
    if "fd" in args:
        flags += ["--fd"]
    for name in ("timing", "bus_kwargs"):
        if name in args:
            flags += [f"--{name.replace('_', '-')}", *(f"{key}={value}" for key, value in getattr(args, name).items())]
    return flags
