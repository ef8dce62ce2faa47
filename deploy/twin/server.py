"""The twin in real time: a thousand steps a second, several programs on its bus.

Behind TCP, or a serial line, on this machine only; or as the node of any bus of python-can (`RawBus`).
"""

import errno
import os
import select
import selectors
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from deploy.puck.frame import Frame
from deploy.twin.client import Client, Conversation
from deploy.twin.raw_bus import RawBus
from deploy.twin.socketcand import Socketcand
from deploy.twin.twin import MILLISECOND, Twin

HOST = "127.0.0.1"
GIVEN_UP_S = 0.1
"""Lag beyond which the twin's time stands still instead of running after the clock [s]."""
MOST_CLIENTS = 32
"""Programs at once. Where there are more, the oldest connection that has never spoken gives way, else the new one."""
ASKED_EVERY_S = 1e-4
"""How often an interface is asked for frames that cannot say when there are some [s]."""


class Server:
    """A twin's buses: a socketcand server, serial lines, interfaces of python-can.

    Attributes:
        port: Where it listens, 0 if nowhere.
        counters: Ticks, those of them that were late, clients, frames that could not be read.
    """

    def __init__(self, twin: Twin, port: int | None = 0) -> None:
        """Listen on the loopback.

        Args:
            twin: The robot.
            port: TCP port; 0 takes a free one, None none.

        Raises:
            OSError: The port is taken.
        """
        self.twin, self.counters = twin, Counter[str]()
        self._selector, self._clients = selectors.EpollSelector(), list[Client]()
        self._buses = list[RawBus]()
        self._spare = os.open(os.devnull, os.O_RDONLY)
        self._listener = None if port is None else socket.create_server((HOST, port))
        self.port = 0
        if self._listener is not None:
            self._listener.setblocking(False)
            self.port = self._listener.getsockname()[1]
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
        client = Client(file, protocol)
        self._clients.append(client)
        self.counters["clients"] += 1
        self._selector.register(file, selectors.EVENT_READ, lambda: self._hear(client))
        self._write(client)

    def join(self, bus: RawBus) -> None:
        """Be a node of a bus of python-can."""
        self._buses.append(bus)
        if bus.descriptor is not None:
            self._selector.register(bus.descriptor, selectors.EVENT_READ, lambda: self._hear_bus(bus))

    def stop(self) -> None:
        """End `run` after the running tick; may be called from anywhere."""
        self._stopping = True

    def run(self, duration: float | None = None, every_tick: Callable[[Twin], object] | None = None) -> None:
        """Serve until `stop`, or for a time [s]; `every_tick` is called after each millisecond."""
        began = time.monotonic_ns() - self.twin.now_ns
        last = None if duration is None else self.twin.now_ns + round(1e9 * duration)
        while not self._stopping and (last is None or self.twin.now_ns < last):
            due = began + self.twin.now_ns + MILLISECOND
            self._wait(max(due - time.monotonic_ns(), 0) * 1e-9)
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
        for bus in self._buses:
            if bus.descriptor is not None:
                self._selector.unregister(bus.descriptor)
            self.counters["frames not understood"] += bus.malformed
            self.counters["frames refused by the interface"] += bus.refused
            bus.close()
        if self._listener is not None:
            self._selector.unregister(self._listener)
            self._listener.close()
        self._selector.close()
        if self._spare >= 0:
            os.close(self._spare)

    def _wait(self, seconds: float) -> None:
        """Serve whoever speaks, for so long [s] or until somebody has spoken."""
        asked = [bus for bus in self._buses if bus.descriptor is None]
        for bus in asked:
            self._hear_bus(bus)
        if asked:
            seconds = min(seconds, ASKED_EVERY_S)
        # epoll bears any number of descriptors and waits whole milliseconds; select waits microseconds, here for epoll.
        try:
            select.select([self._selector], [], [], seconds)
        except ValueError:  # this process had a thousand files open before
            time.sleep(min(seconds, ASKED_EVERY_S))
        for key, _ in self._selector.select(0):
            if key.fd in self._selector.get_map():  # else it was dropped for another one in this round
                key.data()

    def _accept(self) -> None:
        assert self._listener is not None
        silent = next((each for each in self._clients if not each.spoke and isinstance(each.file, socket.socket)), None)
        full = len(self._clients) >= MOST_CLIENTS
        if full and silent is not None:
            self._drop(silent)
        try:
            connection, _ = self._listener.accept()
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.ENFILE):
                self._no_descriptor(silent)
            return
        if full:
            self.counters["clients refused"] += 1
            if silent is None:
                connection.close()
                return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.attach(connection, Socketcand())

    def _no_descriptor(self, silent: Client | None) -> None:
        """Let the silent one make room; else the spare descriptor goes to who knocks, lest he does so for ever."""
        assert self._listener is not None
        self.counters["clients refused"] += 1
        if silent is not None:
            self._drop(silent)
            return
        if self._spare >= 0:
            os.close(self._spare)
        with suppress(OSError):
            self._listener.accept()[0].close()
        try:
            self._spare = os.open(os.devnull, os.O_RDONLY)
        except OSError:
            self._spare = -1

    def _hear_bus(self, bus: RawBus) -> None:
        self._take(bus.hear(), bus)
        if bus.hopeless:
            self.stop()

    def _hear(self, client: Client) -> None:
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
        client.spoke = client.spoke or bool(answer or frames)
        self._take(frames, client)

    def _take(self, frames: list[Frame], sender: Client | RawBus) -> None:
        """Give a program's frames to the robot and to the other programs."""
        for frame in frames:
            if not self.twin.bus_off:
                self._deliver([frame], sender)
            self.twin.receive(frame)
        self._deliver(self.twin.take())

    def _tell_bus_off(self) -> None:
        off = self.twin.bus_off
        if off and not self._was_off:
            for client in list(self._clients):
                client.backlog += client.protocol.say_bus_off(self.twin.now)
                self._write(client)
        self._was_off = off

    def _deliver(self, frames: list[Frame], sender: Client | RawBus | None = None) -> None:
        """Give frames to all programs but the one that sent them."""
        now = time.monotonic()
        for bus in self._buses:
            if bus is not sender:
                for frame in frames:
                    bus.say(frame)
        for client in list(self._clients):
            if client is not sender and frames and client.protocol.listens(now):
                client.backlog += b"".join(client.protocol.say(frame, self.twin.now) for frame in frames)
            self._write(client)

    def _write(self, client: Client) -> None:
        try:
            client.flush()
        except OSError:
            self._drop(client)

    def _drop(self, client: Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.file)
            self.counters["frames not understood"] += client.protocol.malformed
            client.file.close()
