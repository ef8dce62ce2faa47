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

No signal that asks the controller to end ends this process, only the pipe: the way out of the tissue is watched, too.
"""

import argparse
import logging
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any

from deploy.loop.beats import BeatPage
from deploy.loop.realtime import WATCHDOG_PRIORITY, prepare
from deploy.loop.signals import ENDING

IDLE_FRAMES = (
    (0x404, bytes((0x88, 0, 0, 0, 0, 0))),
    (0x00A, bytes((0x88, 0, 1, 0, 0, 0))),
)
"""Written out rather than taken from the controller's codec: this process shares none of it."""
REPEATS_MS = (0, 1, 2, 5, 10, 20)
"""When they are sent, after the decision [ms]: a frame can be lost."""
SOCKET = "_SocketCanDaemonBus__socket"
"""Where python-can's socketcand client keeps its socket."""
_POLL_MS = 1


def overdue(beat: int, now: int, timeout_ns: int, closed: bool) -> str:
    """Reason to lower the arm; empty if there is none.

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


def watch(page: BeatPage, pipe: int, timeout_ns: int, bus: Any, message: Any) -> None:
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
        page.alive = now
        if not fired and (why := overdue(page.beat, now, timeout_ns, closed)):
            fired = True
            page.fired = now
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
        # python-can's socketcand client takes half a processor to understand what nobody will look at, and does not
        # hand out its socket (it has no `fileno`), so it is taken by its private name; without it all is read.
        if (stream := getattr(bus, SOCKET, None)) is not None:
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


def main(argv: Sequence[str] | None = None) -> int:
    """The process; 2 if it cannot open the bus."""
    import can
    from can.cli import add_bus_arguments, create_bus_from_namespace

    description = "started by jaxmpc run, not by hand"
    parser = argparse.ArgumentParser(prog="deploy.loop.watchdog_process", description=description)
    parser.add_argument("--page", type=int, required=True)
    parser.add_argument("--pipe", type=int, required=True)
    parser.add_argument("--timeout-ms", type=float, required=True)
    add_bus_arguments(parser)
    args = parser.parse_args(argv)
    for number in ENDING:  # a service that is stopped, say, tells all its processes: the controller still withdraws
        signal.signal(number, signal.SIG_IGN)
    logging.disable(logging.WARNING)  # some interfaces warn of every frame that comes in two parts
    for name in ("page", "pipe", "timeout_ms"):
        setattr(args, f"_{name}", vars(args).pop(name))  # the rest is the bus
    page = BeatPage(args._page)
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
