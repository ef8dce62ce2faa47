"""Protocol of a serial CAN adapter (Lawicel's): a letter, hexadecimal digits, a carriage return.

    t4041 30            a frame with identifier 404 and one byte (without the space)
    O, C, S8, V, N, F   open, close, bit rate, version, serial number, status

Source: the LAWICEL CANUSB manual, as python-can's `slcan` interface speaks it.
"""

from deploy.puck.frame import Frame

_LONGEST = 4096
_ANSWERS = {"V": b"V1013\r", "N": b"NTWIN\r", "F": b"F00\r"}


class Slcan:
    """The adapter's side of the conversation."""

    greeting = b""

    def __init__(self) -> None:
        self._heard, self._open = b"", False
        self.malformed = 0

    def listens(self, now: float) -> bool:
        """Whether frames may be sent to it at a time [s]."""
        return self._open

    def hear(self, data: bytes, now: float) -> tuple[list[Frame], bytes]:
        """Frames that the host sent, and the text to answer at once."""
        self._heard += data
        frames, answer = [], b""
        *lines, self._heard = self._heard.split(b"\r")
        for line in lines:
            text = line.decode("ascii", "replace").strip()
            frame = _frame(text)
            if frame is not None:
                frames.append(frame)
                answer += b"z\r"
            elif text[:1] in _ANSWERS:
                answer += _ANSWERS[text[:1]]
            elif text[:1] in ("O", "L", "C", "S", "s", "M", "m", "Z"):
                self._open = text[0] in "OL" or (self._open and text[0] != "C")
                answer += b"\r"
            elif text:
                self.malformed += 1
                answer += b"\a"
        if len(self._heard) > _LONGEST:
            self._heard, self.malformed = b"", self.malformed + 1
        return frames, answer

    def say(self, frame: Frame, now: float) -> bytes:
        """A frame for the host."""
        return b"t%03X%d%s\r" % (frame.id, len(frame.data), frame.data.hex().upper().encode())

    def say_bus_off(self, now: float) -> bytes:
        """Nothing: the protocol has no word for it, `F` is asked."""
        return b""


def _frame(text: str) -> Frame | None:
    """A classical frame, None for anything else."""
    try:
        number, length, data = int(text[1:4], 16), int(text[4:5]), bytes.fromhex(text[5:])
    except ValueError:
        return None
    return Frame(number, data) if text[0] == "t" and number < 0x800 and len(data) == length <= 8 else None
