"""The kernel's receive buffer of a socket: made large enough for a burst, and asked what it had to drop.

A full buffer drops the newest frames without a word: 212992 bytes, the usual size, hold 278 CAN frames, a seventh of a
second of a busy bus. The count of drops is that which SO_RXQ_OVFL would send along with each frame; SO_MEMINFO tells it
alone, and python-can does not hand out what comes along.
"""

import socket
import struct
from contextlib import suppress
from typing import Any

WANTED = 4 << 20
"""Size that is asked for [bytes]: 5000 frames of some 766 bytes, as the kernel counts them."""
SO_RCVBUFFORCE, SO_MEMINFO = 33, 55
"""Linux, asm-generic/socket.h: beyond the system's limit, for who may; and the memory of a socket."""
_MEMINFO = struct.Struct("=9I")
_DROPS = 8


def socket_of(bus: Any) -> socket.socket | None:
    """The socket of an interface of python-can that receives datagrams or raw frames; None if it has none."""
    found = getattr(bus, "socket", None)
    stream = isinstance(found, socket.socket) and found.type == socket.SOCK_STREAM
    return found if isinstance(found, socket.socket) and not stream else None


def enlarge(sock: socket.socket, size: int = WANTED) -> int:
    """Ask for a larger buffer; the size that there now is [bytes], as the kernel counts it."""
    before = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    for option in (SO_RCVBUFFORCE, socket.SO_RCVBUF):
        if sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < max(size, before):
            with suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, option, size)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def dropped(sock: socket.socket) -> int | None:
    """Frames that the kernel dropped because the buffer was full; None where it does not tell."""
    try:
        answer = sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size)
    except OSError:
        return None
    return int(_MEMINFO.unpack(answer)[_DROPS]) if len(answer) == _MEMINFO.size else None
