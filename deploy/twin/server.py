"""The twin in real time: a thousand steps a second, several programs on its bus, on this machine only."""

import os
import selectors
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from deploy.puck.frame import Frame
from deploy.twin.slcan import Slcan
from deploy.twin.socketcand import Socketcand
from deploy.twin.twin import MILLISECOND, Twin

Conversation = Socketcand | Slcan
"""How frames are written to and read from one client."""
HOST = "127.0.0.1"
GIVEN_UP_S = 0.1
"""Lag beyond which the twin's time stands still instead of running after the clock [s]."""
_LARGEST_BACKLOG = 1 << 20
"""Bytes that a client may leave unread."""


class _Client:
    """A program on the bus, behind a file descriptor."""

    def __init__(self, file: Any, protocol: Conversation) -> None:
        self.file, self.protocol = file, protocol
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
            if len(self.backlog) > _LARGEST_BACKLOG:
                raise OSError("the client does not read")


class Server:
    """A socketcand server in front of a twin.

    Attributes:
        port: Where it listens.
        counters: Ticks, those of them that were late, clients, frames that could not be read.
    """

    def __init__(self, twin: Twin, port: int = 0) -> None:
        """Listen on the loopback.

        Args:
            twin: The robot.
            port: TCP port; 0 takes a free one.

        Raises:
            OSError: The port is taken.
        """
        self.twin, self.counters = twin, Counter[str]()
        # select's resolution is a microsecond, epoll's a millisecond
        self._selector, self._clients = selectors.SelectSelector(), list[_Client]()
        self._listener = socket.create_server((HOST, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._stopping, self._was_off = False, False

    def watch(self, file: Any, ready: Callable[[], object]) -> None:
        """Call a function whenever a file has something to read."""
        self._selector.register(file, selectors.EVENT_READ, ready)

    def forget(self, file: Any) -> None:
        """Watch a file no longer."""
        self._selector.unregister(file)

    def attach(self, file: Any, protocol: Conversation) -> None:
        """Put a program on the bus, behind a descriptor that does not block."""
        client = _Client(file, protocol)
        self._clients.append(client)
        self.counters["clients"] += 1
        self._selector.register(file, selectors.EVENT_READ, lambda: self._hear(client))
        self._write(client)

    def stop(self) -> None:
        """End `run` after the running tick; may be called from anywhere."""
        self._stopping = True

    def run(self, duration: float | None = None, every_tick: Callable[[Twin], object] | None = None) -> None:
        """Serve until `stop`, or for a time [s]; `every_tick` is called after each millisecond."""
        began = time.monotonic_ns() - self.twin.now_ns
        last = None if duration is None else self.twin.now_ns + round(1e9 * duration)
        while not self._stopping and (last is None or self.twin.now_ns < last):
            due = began + self.twin.now_ns + MILLISECOND
            left = due - time.monotonic_ns()
            for key, _ in self._selector.select(max(left, 0) * 1e-9):
                key.data()
            lag = time.monotonic_ns() - due
            if lag < 0:
                continue
            if lag > 1e9 * GIVEN_UP_S:
                self.counters["milliseconds given up"] += lag // MILLISECOND
                began += lag // MILLISECOND * MILLISECOND
            self.counters["ticks"] += 1
            self.counters["late ticks"] += lag > MILLISECOND
            self.twin.advance()
            self._tell_bus_off()
            self._deliver(self.twin.take())
            if every_tick is not None:
                every_tick(self.twin)

    def close(self) -> None:
        """Leave all clients and the port."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._listener)
        self._listener.close()
        self._selector.close()

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.attach(connection, Socketcand())

    def _hear(self, client: _Client) -> None:
        try:
            data = os.read(client.file.fileno(), 65536)
            if isinstance(client.file, socket.socket) and hasattr(socket, "TCP_QUICKACK"):
                # Else a client without TCP_NODELAY waits up to 40 ms for the acknowledgement of its last frame.
                client.file.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        frames, answer = client.protocol.hear(data, time.monotonic())
        client.backlog += answer
        for frame in frames:
            if not self.twin.bus_off:
                self._deliver([frame], client)
            self.twin.receive(frame)
        self._deliver(self.twin.take())

    def _tell_bus_off(self) -> None:
        off = self.twin.bus_off
        if off and not self._was_off:
            for client in list(self._clients):
                client.backlog += client.protocol.say_bus_off(self.twin.now)
                self._write(client)
        self._was_off = off

    def _deliver(self, frames: list[Frame], sender: _Client | None = None) -> None:
        """Give frames to all clients but the one that sent them."""
        now = time.monotonic()
        for client in list(self._clients):
            if client is not sender and frames and client.protocol.listens(now):
                client.backlog += b"".join(client.protocol.say(frame, self.twin.now) for frame in frames)
            self._write(client)

    def _write(self, client: _Client) -> None:
        try:
            client.flush()
        except OSError:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.file)
            self.counters["frames not understood"] += client.protocol.malformed
            client.file.close()
