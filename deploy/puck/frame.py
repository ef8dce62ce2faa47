"""A CAN frame, free of any driver."""

from typing import NamedTuple


class Frame(NamedTuple):
    """A classical data frame with an 11-bit identifier.

    Attributes:
        id: Group flag 0x400, sender in bits 9-5, receiver or group in bits 4-0.
        data: Up to 8 bytes.
    """

    id: int
    data: bytes

    def __str__(self) -> str:
        return f"{self.id:03X} [{self.data.hex(' ').upper()}]"
