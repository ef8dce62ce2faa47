"""A second process that lowers the arm when the controller no longer can.

The controller writes the time into a page of shared memory once per cycle (the beat). This process, with a bus
connection and an interpreter of its own, looks at it every millisecond. It sends the frames below if torques are
on and the last beat is too old (the controller hangs, is stopped, or is not scheduled), or if the pipe between
the two is closed (the controller is gone, however it died).

    0x404 [88 00 00 00 00 00]    SET MODE = 0 (idle) on every puck of the arm
    0x00A [88 00 01 00 00 00]    SET MODE = 1 (idle) on the safety module

Pucks that idle ignore torques and brake through their windings; they hold nothing up. Having acted, it says so in
the same page before it sends: whatever the controller still is, its next cycle sees `fired` and stops. It acts
once in its life: starting again takes a new watchdog, and a person.
"""

import argparse
import logging
import mmap
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

TIMEOUT_MS = 5.0
"""Age of the last beat at which it acts [ms]."""
IDLE_FRAMES = (
    (0x404, bytes((0x88, 0, 0, 0, 0, 0))),
    (0x00A, bytes((0x88, 0, 1, 0, 0, 0))),
)
"""Written out rather than taken from the controller's codec: this process shares none of its code."""
REPEATS_MS = (0, 1, 2, 5, 10, 20)
"""When they are sent, after the decision [ms]: a frame can be lost."""
_POLL_MS = 1
_STALE_NS = 100_000_000
_BEAT, _FIRED, _ALIVE = 0, 8, 16
"""Offsets in the page, each a signed 64-bit number [ns]: the last beat, negative while torques are off; when it
acted, 0 if never; when the watchdog last looked."""
_PAGE = 4096
_NUMBER = struct.Struct("q")


class WatchdogError(ValueError):
    """No watchdog stands by; the message is a sentence that says why."""


class Watchdog:
    """The controller's end."""

    def __init__(self, bus_flags: Sequence[str], timeout_ms: float = TIMEOUT_MS, ready_within: float = 15.0) -> None:
        """Start the process and wait until it stands by.

        Args:
            bus_flags: The flags of the bus (`can.cli`), as the controller's own command line had them.
            timeout_ms: Age of the last beat at which it acts [ms].
            ready_within: Patience for its start [s].

        Raises:
            WatchdogError: It did not start, or cannot open its bus.
        """
        page = os.memfd_create("jaxmpc-watchdog")
        os.ftruncate(page, _PAGE)
        self._page = mmap.mmap(page, _PAGE)
        ours, theirs = os.pipe()[::-1]
        command = [sys.executable, "-m", "deploy.loop.watchdog", "--page", str(page), "--pipe", str(theirs)]
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
        end = time.monotonic() + ready_within
        while not self._read(_ALIVE):
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
        _NUMBER.pack_into(self._page, _BEAT, now if torques_on else -now)

    @property
    def fired(self) -> bool:
        """Whether it has acted; then it stays so, and no torque may be sent."""
        return self._read(_FIRED) != 0

    def answers(self, now: int) -> bool:
        """Whether it has itself looked within the last 100 ms of `time.monotonic_ns()`; else stop."""
        return now - self._read(_ALIVE) < _STALE_NS

    def close(self) -> None:
        """Stand down and end it; safe to call again."""
        if self._pipe is None:
            return
        _NUMBER.pack_into(self._page, _BEAT, -time.monotonic_ns())
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
        self.close()

    def _read(self, offset: int) -> int:
        return int(_NUMBER.unpack_from(self._page, offset)[0])


def overdue(beat: int, now: int, timeout_ns: int, closed: bool) -> str:
    """Why the arm must be lowered; empty if it must not.

    Args:
        beat: Time of the last beat [ns], negative while torques are off, 0 before the first.
        now: The present [ns].
        timeout_ns: Age of a beat that is too old [ns].
        closed: Whether the controller's end of the pipe is closed.
    """
    if beat <= 0:
        return ""
    if closed:
        return "the controller is gone"
    age = now - beat
    return f"no beat for {age / 1e6:.1f} ms" if age > timeout_ns else ""


def watch(page: mmap.mmap, pipe: int, timeout_ns: int, bus: Any, message: Any) -> None:
    """Look every millisecond until the pipe is closed.

    Args:
        page: Shared with the controller.
        pipe: Closed by the controller's end, in whatever way.
        timeout_ns: Age of a beat that is too old [ns].
        bus: Of python-can.
        message: Makes one of its messages from an id and data.
    """
    poll = select.poll()
    poll.register(pipe, select.POLLIN)  # and POLLHUP, always
    fired = closed = False
    while not closed:
        closed = bool(poll.poll(_POLL_MS))
        now = time.monotonic_ns()
        _NUMBER.pack_into(page, _ALIVE, now)
        if not fired and (why := overdue(_NUMBER.unpack_from(page, _BEAT)[0], now, timeout_ns, closed)):
            fired = True
            _NUMBER.pack_into(page, _FIRED, now)
            failures = _lower(bus, message, now)
            took = f", {failures} of {len(REPEATS_MS) * len(IDLE_FRAMES)} frames failed" if failures else ""
            _say(f"{why}: IDLE sent to pucks and safety module{took}; the arm only brakes and may sag")
        _drain(bus)


def _lower(bus: Any, message: Any, since: int) -> int:
    """Send the frames, several times; the number that failed."""
    failures = 0
    for at_ms in REPEATS_MS:
        wait = since + at_ms * 1_000_000 - time.monotonic_ns()
        time.sleep(max(wait, 0) * 1e-9)
        for number, data in IDLE_FRAMES:
            try:
                bus.send(message(arbitration_id=number, data=data, is_extended_id=False))
            except Exception:  # a bus that is gone says so in many ways; the next attempt must still be made
                failures += 1
    return failures


def _drain(bus: Any) -> None:
    """Throw away what the bus received: a connection that is never read can hold up the others of a server."""
    try:
        # python-can's socketcand client takes half a processor to understand what nobody will look at.
        if (stream := getattr(bus, "_SocketCanDaemonBus__socket", None)) is not None:
            while stream.recv(1 << 16, socket.MSG_DONTWAIT):
                pass
            return
        for _ in range(100):
            if bus.recv(0) is None:
                return
    except Exception:  # receiving is not its duty
        return


def _say(text: str) -> None:
    try:
        os.write(2, f"watchdog: {text}\n".encode())
    except OSError:
        pass


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


def main(argv: Sequence[str] | None = None) -> int:
    """The process; 2 if it cannot open the bus."""
    import can
    from can.cli import add_bus_arguments, create_bus_from_namespace

    from deploy.loop.realtime import WATCHDOG_PRIORITY, prepare

    parser = argparse.ArgumentParser(prog="deploy.loop.watchdog", description="started by jaxmpc run, not by hand")
    parser.add_argument("--page", type=int, required=True)
    parser.add_argument("--pipe", type=int, required=True)
    parser.add_argument("--timeout-ms", type=float, default=TIMEOUT_MS)
    add_bus_arguments(parser)
    args = parser.parse_args(argv)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.disable(logging.WARNING)  # some interfaces warn of every frame that comes in two parts
    for name in ("page", "pipe", "timeout_ms"):
        setattr(args, f"_{name}", vars(args).pop(name))  # the rest is the bus
    page = mmap.mmap(args._page, _PAGE)
    try:
        # A kernel need not copy here what is only thrown away; anywhere else a filter would but slow that down.
        in_kernel = getattr(args, "interface", None) == "socketcan"
        nothing: dict[str, Any] = (
            {"can_filters": [{"can_id": 0x7FF, "can_mask": 0x7FF, "extended": False}]} if in_kernel else {}
        )
        bus = create_bus_from_namespace(args, **nothing)
    except Exception as error:  # each interface of python-can has errors of its own
        cause = error.__context__ or error
        _say(f"cannot open the bus: {cause}")
        return 2
    prepare(WATCHDOG_PRIORITY)
    watch(page, args._pipe, int(1e6 * args._timeout_ms), bus, can.Message)
    bus.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
