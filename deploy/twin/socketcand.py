"""Protocol of a socketcand server: text in angle brackets over TCP.

    server              client
    < hi >
                        < open can0 >
    < ok >
                        < rawmode >
    < ok >
    < frame 423 1.500000 000002 >
                        < send 404 1 30 >

Source: github.com/linux-can/socketcand, doc/protocol.md, and python-can's `socketcand` interface, whose handshake
breaks if a frame follows the last `< ok >` at once: hence the pause of `QUIET_S`, which the client's first frame ends.
"""

from deploy.puck.frame import Frame

QUIET_S = 0.1
_LONGEST = 4096
"""Longest message that may still lack its end [bytes]."""


class Socketcand:
    """One client's side of the conversation."""

    greeting = b"< hi >"

    def __init__(self) -> None:
        self._heard, self._listens_from = b"", float("inf")
        self.malformed = 0

    def listens(self, now: float) -> bool:
        """Whether frames may be sent to it at a time [s]."""
        return now >= self._listens_from

    def hear(self, data: bytes, now: float) -> tuple[list[Frame], bytes]:
        """Frames that a client sent, and the text to answer at once."""
        self._heard += data
        frames, answer = [], b""
        while (end := self._heard.find(b">")) >= 0:
            words = self._heard[:end].partition(b"<")[2].decode("ascii", "replace").split()
            self._heard = self._heard[end + 1 :]
            match words:
                case ["open" | "rawmode" as word, *_]:
                    answer += b"< ok >"
                    if word == "rawmode":
                        self._listens_from = now + QUIET_S
                case ["echo"]:
                    answer += b"< echo >"
                case ["send", identifier, length, *data_words]:
                    frame = _frame(identifier, length, data_words)
                    self._listens_from = min(self._listens_from, now)
                    if frame is None:
                        self.malformed += 1
                    else:
                        frames.append(frame)
                case _:
                    self.malformed += 1
        if len(self._heard) > _LONGEST:
            self._heard, self.malformed = b"", self.malformed + 1
        return frames, answer

    def say(self, frame: Frame, now: float) -> bytes:
        """A frame for the client, stamped with a time [s]."""
        return b"< frame %03X %.6f %s >" % (frame.id, now, frame.data.hex().upper().encode())

    def say_bus_off(self, now: float) -> bytes:
        """Linux' error frame for bus-off."""
        return b"< error 00000040 %.6f >" % now


def _frame(identifier: str, length: str, words: list[str]) -> Frame | None:
    """A classical frame; python-can leaves leading zeros of bytes away. None for any other."""
    try:
        number, data = int(identifier, 16), bytes(int(word, 16) for word in words)
    except ValueError:
        return None
    if len(identifier) > 3 or not 0 <= number < 0x800 or str(len(data)) != length or len(data) > 8:
        return None
    return Frame(number, data)
