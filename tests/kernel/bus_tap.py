"""What the test sees and does on the guest's bus, through sockets of its own: orders heard, error frames, questions."""

import os
import socket
import struct
import time
from typing import NamedTuple

from deploy.puck.codec import unpack_torques

CHANNEL = "vcan0"
TORQUE, IDLE_PUCKS, IDLE_SAFETY = 0x401, (0x404, bytes((0x88, 0, 0, 0, 0, 0))), (0x00A, bytes((0x88, 0, 1, 0, 0, 0)))
ASK_MODE, MODE_REPLY = (0x00A, bytes((8,))), 0x546
CONTROLLER_STATE, BUS_OFF = 0x004, 0x040
_FRAME, _ERROR, _LARGE = struct.Struct("=IB3x8s"), 0x20000000, 1 << 23
_STAMPED, _SO_RCVBUFFORCE = 35, 33
_DILATE = int(os.environ.get("DILATE", "1"))


class Heard(NamedTuple):
    """A frame on the bus: when by the programs' wall clock [s], as the kernel stamped it, and what."""

    at: float
    number: int
    data: bytes


class BusTap:
    """Listens to what hosts order and the safety module answers; the kernel keeps it until it is asked."""

    def __init__(self) -> None:
        """Listen from now on."""
        self._socket = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        wanted = (TORQUE, IDLE_PUCKS[0], IDLE_SAFETY[0], MODE_REPLY)
        filters = b"".join(struct.pack("=II", number, 0x7FF) for number in wanted)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _LARGE)
        self._socket.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
        self._socket.bind((CHANNEL,))
        self._socket.setblocking(False)
        self._frames: list[Heard] = []

    @property
    def frames(self) -> list[Heard]:
        """All that was heard."""
        while True:
            try:
                data, said, _, _ = self._socket.recvmsg(64, 64)
            except OSError:  # nothing more, or the link has gone down
                return self._frames
            seconds, nanoseconds = next(struct.unpack("=qq", each) for _, kind, each in said if kind == _STAMPED)
            number, length, payload = _FRAME.unpack(data)
            at = (seconds + 1e-9 * nanoseconds) / _DILATE
            self._frames.append(Heard(at, number & 0x7FF, payload[:length]))

    def driven(self) -> list[float]:
        """When torques that are not zero were sent [s]."""
        return [at for at, number, data in self.frames if number == TORQUE and any(unpack_torques(data) or ())]

    def idled(self, since: float) -> float | None:
        """When pucks and safety module had both been told to idle [s]; None if they have not."""
        first: dict[int, float] = {}
        for at, number, data in self.frames:
            if at >= since and (number, data) in (IDLE_PUCKS, IDLE_SAFETY):
                first.setdefault(number, at)
        return max(first.values()) if len(first) == 2 else None

    def safety_mode(self) -> int | None:
        """What the safety module says of itself: 0 e-stop, 1 idle, 2 active; None without an answer."""
        since = time.time()
        send(*ASK_MODE)
        time.sleep(0.05)
        return next((data[2] for at, number, data in self.frames if at > since and number == MODE_REPLY), None)

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()


def send(number: int, data: bytes) -> None:
    """Send a frame."""
    with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as out:
        out.bind((CHANNEL,))
        out.send(_FRAME.pack(number, len(data), data.ljust(8, b"\0")))


def send_bus_off() -> None:
    """Send what a CAN controller's driver sends when it goes bus-off; vcan itself never does."""
    send(_ERROR | BUS_OFF, bytes(8))
