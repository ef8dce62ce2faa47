"""A program on the twin's bus, behind a file descriptor that does not block."""

import os
from typing import Any

from deploy.twin.slcan import Slcan
from deploy.twin.socketcand import Socketcand

Conversation = Socketcand | Slcan
"""How frames are written to and read from one client."""
LARGEST_BACKLOG = 1 << 20
"""Bytes that a client may leave unread."""


class Client:
    """A program on the bus, behind a file descriptor.

    Attributes:
        file: Its descriptor.
        protocol: Its conversation.
        spoke: Whether it has ever said anything.
        backlog: Bytes that it has not read yet.
    """

    def __init__(self, file: Any, protocol: Conversation) -> None:
        """Begin with the protocol's greeting."""
        self.file, self.protocol, self.spoke = file, protocol, False
        self.backlog = bytearray(protocol.greeting)

    def flush(self) -> None:
        """Write what the descriptor takes.

        Raises:
            OSError: The client has gone.
        """
        if self.backlog:
            try:
                del self.backlog[: os.write(self.file.fileno(), self.backlog)]
            except BlockingIOError:
                pass
            if len(self.backlog) > LARGEST_BACKLOG:
                raise OSError("the client does not read")
