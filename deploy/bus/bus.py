"""The bus: python-can in, frames out; whatever is none of ours is dropped and counted, and nothing is retried."""

import errno
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import can

from deploy.bus import receive_buffer
from deploy.bus.error_frames import BusState, graver, state_of
from deploy.puck.codec import HOST, PUCKS, SAFETY_MODULE, SENSOR
from deploy.puck.frame import Frame

MOST_AT_ONCE: Final = 64
"""Frames that are read when the time is up: a bus on which somebody babbles never runs dry. A millisecond holds 18."""
SENDS_AFTER_ERROR: Final = 4
"""Frames that are still tried in any second after an error: enough to lower the arm's state, no retrying."""
SECOND: Final = 1_000_000_000


@dataclass(slots=True)
class Counters:
    """What happened on the bus since it was opened [frames].

    Attributes:
        sent: Handed to the driver.
        received: Data frames from a node that belongs here.
        foreign: From any other node, or from another host; these are counted in `hosts` too.
        hosts: From another host: somebody else commands this arm.
        malformed: With extended identifier, remote, CAN FD, or an error frame.
        send_errors: Refused by the driver.
        receive_errors: Attempts to read frames, or the controller's state, that failed.
        held: Not even tried, because an error had happened before.
        dropped: By the kernel, because they were not read in time; counted by `count_dropped`.
    """

    sent: int = 0
    received: int = 0
    foreign: int = 0
    hosts: int = 0
    malformed: int = 0
    send_errors: int = 0
    receive_errors: int = 0
    held: int = 0
    dropped: int = 0


class Bus:
    """A CAN bus with frames of pucks on it; after `__init__` no method raises.

    An error stays: `state` is "active" until the first one, and then never again but by `recover`, because who drives
    an arm must not go on by itself. From then on at most `SENDS_AFTER_ERROR` frames a second are tried.
    """

    def __init__(
        self,
        bus: can.BusABC,
        now: Callable[[], int] = time.monotonic_ns,
        nodes: Iterable[int] = (*PUCKS, SENSOR, SAFETY_MODULE),
    ) -> None:
        """Take over a bus of python-can.

        Args:
            bus: Opened; `close` shuts it down.
            now: The clock that frames are stamped with [ns]; never the wall clock, which jumps.
            nodes: Senders that belong here.
        """
        self.counters = Counters()
        self.now = now
        self.dry = True
        channel = getattr(bus, "channel", None)
        self.name = channel if isinstance(channel, str) and channel else "can0"
        self._bus = bus
        self._state: BusState = "active"
        self._socket = receive_buffer.socket_of(bus)
        self.buffer = receive_buffer.enlarge(self._socket) if self._socket is not None else 0
        self._attempts = [-SECOND] * SENDS_AFTER_ERROR
        self.listen_to(nodes)
        # `recv` of python-can measures its timeout on the wall clock: set back by an hour, it waits that hour.
        own = getattr(type(bus), "_recv_internal", None) not in (None, can.BusABC._recv_internal)
        self._read: Callable[[float], can.Message | None] = self._read_internal if own else bus.recv

    def listen_to(self, nodes: Iterable[int]) -> None:
        """Let other senders than before belong here."""
        self._senders = frozenset(node << 5 for node in nodes)

    @property
    def state(self) -> BusState:
        """What can be relied on; "down" is a network interface that is down, "off" bus-off or no interface."""
        if self._state == "active":
            try:
                told = self._bus.state
            except Exception as error:  # some drivers ask their adapter, which may have been pulled out
                self.counters.receive_errors += 1
                self._fail(_meaning(error, "off"))
                return self._state
            if told is not can.BusState.ACTIVE:
                self._fail("off" if told is can.BusState.ERROR else "error")
        return self._state

    @property
    def remedy(self) -> str:
        """What to do about the state."""
        if self.state == "down":
            return f"the interface is down (Network is down): `ip link set {self.name} up`"
        return "check that the arm is powered, the cable and its 120 Ω terminators, and 1 Mbit/s at the adapter"

    def recover(self, probe: Frame) -> bool:
        """Return to active after the interface was down, if a frame can be sent; only while nothing may move.

        Args:
            probe: That frame; a question.
        """
        if self._state == "down":
            self._state, self._attempts = "active", [-SECOND] * SENDS_AFTER_ERROR
            self.send(probe)
        return self.state == "active"

    def send(self, frame: Frame) -> bool:
        """Hand a frame to the driver; False if it was refused or, after an error, not even tried."""
        if self._state != "active" and not self._may_try():
            self.counters.held += 1
            return False
        message = can.Message(arbitration_id=frame.id, is_extended_id=False, data=frame.data)
        try:
            self._bus.send(message, timeout=0.0)
        except Exception as error:  # drivers fail in ways of their own, and letting go must still be tried
            self.counters.send_errors += 1
            if self._state == "active":
                self._may_try()
            self._fail(_meaning(error, "error"))
            return False
        self.counters.sent += 1
        return True

    def receive(self, timeout_s: float) -> tuple[Frame, int] | None:
        """The next frame of ours and when it was read [ns]; None if there is none in time.

        Args:
            timeout_s: How long to wait for it [s]; 0 takes what is there already.
        """
        before = self.now()
        timeout_s = max(timeout_s, 0.0)  # a deadline that has passed: drivers take a negative wait for an error
        deadline, left, overdue = before + int(timeout_s * 1e9), timeout_s, 0
        while True:
            message = self._take(left)
            stamp = self.now()
            if message is None:
                # a simulated clock stands still: nothing comes by waiting
                if stamp >= deadline or stamp == before or self._state in ("off", "down"):
                    return None
            elif self._belongs(message):
                return Frame(message.arbitration_id, bytes(message.data)), stamp
            elif stamp >= deadline:
                overdue += 1
                if overdue > MOST_AT_ONCE:
                    return None
            left = max(deadline - stamp, 0) * 1e-9

    def drain(self, limit: int = MOST_AT_ONCE) -> list[tuple[Frame, int]]:
        """What has come already, each with when it was read [ns]; reads at most so many frames, ours or not.

        Afterwards `dry` says whether that was all.
        """
        frames = []
        self.dry = False
        for _ in range(limit):
            if (message := self._take(0.0)) is None:
                self.dry = True
                break
            if self._belongs(message):
                frames.append((Frame(message.arbitration_id, bytes(message.data)), self.now()))
        return frames

    def flush(self) -> int:
        """Throw away what has come already, for a tenth of a second at most; how many of ours these were."""
        deadline, before = self.now() + SECOND // 10, self.counters.received
        while self.now() < deadline and (message := self._take(0.0)) is not None:
            self._belongs(message)
        return self.counters.received - before

    def count_dropped(self) -> int:
        """Ask the kernel how many frames it dropped since the bus was opened; 0 where it does not tell."""
        if self._socket is not None and (found := receive_buffer.dropped(self._socket)) is not None:
            self.counters.dropped = found
        return self.counters.dropped

    def close(self) -> None:
        """Give the interface back."""
        try:
            self._bus.shutdown()
        except Exception:
            self._fail("off")  # whatever it was: nothing can be done, and closing must not hide another error

    def _take(self, timeout_s: float) -> can.Message | None:
        try:
            return self._read(timeout_s)
        except Exception as error:
            self.counters.receive_errors += 1
            self._fail(_meaning(error, "off"))
            return None

    def _read_internal(self, timeout_s: float) -> can.Message | None:
        return self._bus._recv_internal(timeout_s)[0]

    def _belongs(self, message: can.Message) -> bool:
        if message.is_error_frame:
            self.counters.malformed += 1
            self._fail(state_of(message.arbitration_id, bytes(message.data)))
            return False
        if message.is_extended_id or message.is_remote_frame or message.is_fd or len(message.data) > 8:
            self.counters.malformed += 1
            return False
        sender = message.arbitration_id & 0x3E0
        if sender in self._senders:
            self.counters.received += 1
            return True
        self.counters.foreign += 1
        self.counters.hosts += sender == HOST
        return False

    def _may_try(self) -> bool:
        """Whether one more attempt to send stays below the bound after an error; counts it if so."""
        stamp = self.now()
        if stamp - self._attempts[0] < SECOND:
            return False
        self._attempts = [*self._attempts[1:], stamp]
        return True

    def _fail(self, state: BusState) -> None:
        self._state = graver(self._state, state)


def _meaning(error: Exception, usual: BusState) -> BusState:
    """The state that a driver's error means; most tell the system's number of it."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number == errno.ENETDOWN:
        return "down"
    return "off" if number in (errno.ENODEV, errno.ENXIO) else usual
