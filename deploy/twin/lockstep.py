"""The twin's bus within the process: time goes by only when somebody waits, so every run is the same.

clock = Clock(Twin(Settings()))
bus = LockstepBus(clock)          # a can.BusABC like any other; as many as there are programs on the bus
...
clock.wait_until(clock.now() + 1_000_000)
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import can

from deploy.puck.frame import Frame
from deploy.twin.twin import MILLISECOND, Twin


class LockstepClock:
    """The twin's time [ns], from 0 on; it and not the computer decides what is late.

    Attributes:
        twin: The robot.
        every_tick: Called after every millisecond of the twin, to watch it; None calls nothing.
    """

    def __init__(self, twin: Twin, every_tick: Callable[[Twin], None] | None = None) -> None:
        """Start at the twin's time.

        Args:
            twin: The robot.
            every_tick: Called after every millisecond of the twin, to watch it.
        """
        self.twin, self.every_tick = twin, every_tick
        self._now = twin.now_ns
        self._buses: list[LockstepBus] = []

    def now(self) -> int:
        """Time [ns]."""
        return self._now

    def wait_until(self, deadline_ns: int) -> None:
        """Let time go by until a deadline [ns]; one that has passed costs nothing."""
        while self.twin.now_ns + MILLISECOND <= deadline_ns:
            self._now = self.twin.now_ns + MILLISECOND
            self.deliver()
            self.twin.advance()
            if self.every_tick is not None:
                self.every_tick(self.twin)
        self._now = max(self._now, deadline_ns)
        self.deliver()

    def join(self, bus: "LockstepBus") -> None:
        """Connect a bus."""
        self._buses.append(bus)

    def leave(self, bus: "LockstepBus") -> None:
        """Disconnect it."""
        if bus in self._buses:
            self._buses.remove(bus)

    def send(self, frame: Frame, sender: "LockstepBus") -> None:
        """Give a frame to the robot and to the other programs on the bus."""
        if not self.twin.bus_off:
            for bus in self._buses:
                if bus is not sender:
                    bus.arrived.append((self._now, frame))
        self.twin.receive(frame, self._now)
        self.deliver()

    def deliver(self) -> None:
        """Hand out what has arrived by now."""
        for frame in self.twin.take(self._now):
            for bus in self._buses:
                bus.arrived.append((self._now, frame))


class LockstepBus(can.BusABC):
    """A bus of python-can's kind at the twin."""

    def __init__(self, clock: LockstepClock, can_filters: Any = None) -> None:
        """Connect to the robot of a clock."""
        self.clock, self.channel_info = clock, "the twin, in lock-step"
        self.arrived: deque[tuple[int, Frame]] = deque()
        clock.join(self)
        super().__init__(channel="twin", can_filters=can_filters)

    @property  # type: ignore[misc]  # nobody sets it: the twin does
    def state(self) -> can.BusState:
        """Whether the controller is on the bus; python-can knows no worse state than ERROR."""
        return can.BusState.ERROR if self.clock.twin.bus_off else can.BusState.ACTIVE

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame.

        Raises:
            can.CanOperationError: The controller is bus-off.
        """
        if self.clock.twin.bus_off:
            self.clock.twin.receive(Frame(msg.arbitration_id, bytes(msg.data)))
            raise can.CanOperationError("the controller is bus-off")
        if msg.is_extended_id or msg.is_remote_frame or msg.is_error_frame or msg.is_fd:
            self.clock.twin.counters["not understood"] += 1
            return
        self.clock.send(Frame(msg.arbitration_id, bytes(msg.data)), self)

    def shutdown(self) -> None:
        """Leave the bus."""
        self.clock.leave(self)
        super().shutdown()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; time goes by while none is there, at most for `timeout` [s].

        Raises:
            ValueError: There is no time-out and nothing is under way: it would wait for ever.
        """
        deadline = None if timeout is None else self.clock.now() + max(round(1e9 * timeout), 0)
        while True:
            while self.arrived:
                at, frame = self.arrived.popleft()
                message = can.Message(
                    timestamp=1e-9 * at, arbitration_id=frame.id, is_extended_id=False, data=frame.data
                )
                if self._matches_filters(message):
                    return message
            now, coming = self.clock.now(), self.clock.twin.next_ns()
            if deadline is None and coming is None:
                raise ValueError("nothing is under way on the twin's bus: give recv a time-out")
            if deadline is not None and now >= deadline:
                return None
            until = self.clock.twin.now_ns + MILLISECOND
            for each in (coming, deadline):
                if each is not None and now < each < until:
                    until = each
            self.clock.wait_until(until)
