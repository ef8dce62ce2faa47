"""A bus of python-can at which the twin is one of the nodes: a frame a message, nothing around it.

Any interface will do: socketcan on `vcan0`, udp_multicast between computers, virtual within a process.
"""

from typing import Any

import can

from deploy.puck.codec import HOST
from deploy.puck.frame import Frame

AT_ONCE = 64
"""Frames that are read in a row; a millisecond of the real bus holds 18."""
SENDER = 0x3E0
"""Bits of an identifier that say who sends; the robot listens to hosts alone."""
HOPELESS = 1000
"""Errors in a row, one a millisecond, after which the interface is given up."""


class RawBus:
    """The twin's end of the bus.

    Attributes:
        descriptor: What becomes readable when a frame comes; None where the interface has none and must be asked.
        refused: Frames that could not be sent.
        malformed: Frames that no puck would take: extended, remote, CAN FD, error frames.
        errors: Attempts in a row that failed.
    """

    def __init__(self, bus: can.BusABC) -> None:
        """Take over an opened bus of python-can."""
        self._bus = bus
        self.refused = self.malformed = self.errors = 0
        self.descriptor = _descriptor(bus)

    @property
    def hopeless(self) -> bool:
        """Whether the interface has gone for good."""
        return self.errors >= HOPELESS

    def hear(self) -> list[Frame]:
        """Frames of hosts that have come, without waiting for any."""
        frames = []
        for _ in range(AT_ONCE):
            try:
                message = self._bus.recv(0.0)
            except (can.CanError, OSError, ValueError):
                self.errors += 1
                break
            self.errors = 0
            if message is None:
                break
            if message.is_extended_id or message.is_remote_frame or message.is_fd or message.is_error_frame:
                self.malformed += 1
            elif message.arbitration_id & SENDER == HOST:  # some interfaces give back what was sent by it
                frames.append(Frame(message.arbitration_id, bytes(message.data)))
        return frames

    def say(self, frame: Frame) -> None:
        """Send a frame; one that the interface refuses is lost, as on a real bus."""
        try:
            self._bus.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False), timeout=0.0)
        except (can.CanError, OSError, ValueError):
            self.refused += 1

    def close(self) -> None:
        """Give the interface back."""
        self._bus.shutdown()


def _descriptor(bus: Any) -> int | None:
    try:
        number = bus.fileno()
    except (NotImplementedError, can.CanError, OSError):
        return None
    return number if isinstance(number, int) and number >= 0 else None
