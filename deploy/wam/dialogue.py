"""Questions and orders to single nodes, one after the other, before the cycle begins."""

from collections import Counter
from collections.abc import Sequence
from typing import Final, Protocol

from deploy.bus.bus import Bus
from deploy.errors import BusError
from deploy.puck.codec import SAFETY_MODULE, SENSOR, decode, get, set_value
from deploy.puck.frame import Frame
from deploy.puck.messages import Position, PropertyReply

NS: Final = 1_000_000_000
TRIES: Final = 3
"""Times that a question is asked: one frame may be lost."""
NAMES: Final = {SAFETY_MODULE: "the safety module", SENSOR: "the force sensor"}


def name_of(node: int) -> str:
    """A node, for people."""
    return NAMES.get(node, f"puck {node}")


class Clock(Protocol):
    """The loop's clock: the monotonic one, or that of a twin in lock-step."""

    def now(self) -> int:
        """Time [ns]."""
        ...

    def wait_until(self, deadline_ns: int, /) -> object:
        """Let time pass until then [ns]."""
        ...


class Dialogue:
    """Asks single nodes and keeps every answer, however late.

    Attributes:
        properties: Last answer by node and property.
        positions: Last position by node [counts].
        answers: How many there were by node and property.
    """

    def __init__(self, bus: Bus, clock: Clock) -> None:
        """Begin on a bus that nobody else reads."""
        self.bus, self.clock = bus, clock
        self.properties: dict[tuple[int, int], int] = {}
        self.positions: dict[int, int] = {}
        self.answers: Counter[tuple[int, int]] = Counter()

    def tell(self, frame: Frame) -> None:
        """Send a frame.

        Raises:
            BusError: The bus does not take it.
        """
        if not self.bus.send(frame):
            raise BusError(f"the bus takes no frames (it is {self.bus.state}): {self.bus.remedy}; then start again")

    def order(self, node: int, number: int, value: int, then_s: float = 0.0) -> None:
        """Set a property, then let some time pass [s]."""
        self.tell(set_value(node, number, value))
        self.listen(then_s)

    def ask(self, node: int, number: int, timeout_s: float = 0.05) -> int | None:
        """A node's property, None if it does not answer in time, `TRIES` times."""
        self.properties.pop((node, number), None)
        for _ in range(TRIES):
            self.tell(get(node, number))
            deadline = self.clock.now() + int(timeout_s * NS)
            while (node, number) not in self.properties and self.clock.now() < deadline:
                self._listen_once(deadline)
            if (node, number) in self.properties:
                return self.properties[node, number]
        return None

    def must(self, node: int, number: int) -> int:
        """A node's property.

        Raises:
            BusError: It does not answer, or the bus takes no frames.
        """
        value = self.ask(node, number)
        if value is None:
            said = f"{name_of(node)} stopped answering (property {number})"
            raise BusError(f"{said}: check its cable and that it has power")
        return value

    def ask_positions(self, question: Frame, nodes: Sequence[int], timeout_s: float = 0.05) -> list[int] | None:
        """The positions of all these nodes [counts], None if one of them does not answer."""
        for _ in range(TRIES):
            self.positions.clear()
            self.tell(question)
            deadline = self.clock.now() + int(timeout_s * NS)
            while not self.positions.keys() >= set(nodes) and self.clock.now() < deadline:
                self._listen_once(deadline)
            if self.positions.keys() >= set(nodes):
                return [self.positions[node] for node in nodes]
        return None

    def told_positions(self, question: Frame, nodes: Sequence[int]) -> list[int]:
        """The positions of all these nodes [counts].

        Raises:
            BusError: One of them does not answer, or the bus takes no frames.
        """
        counts = self.ask_positions(question, nodes)
        if counts is None:
            missing = next(node for node in nodes if node not in self.positions)
            raise BusError(
                f"puck {missing} does not tell its position when all are asked: check its GRPC (4) with btutil"
            )
        return counts

    def listen(self, duration_s: float) -> None:
        """Send nothing for a while [s], and keep what is said."""
        deadline = self.clock.now() + int(duration_s * NS)
        while self.clock.now() < deadline:
            self._listen_once(deadline)

    def _listen_once(self, deadline: int) -> None:
        """Take one frame, or let at most a millisecond pass."""
        step = min(self.clock.now() + NS // 1000, deadline)
        got = self.bus.receive((step - self.clock.now()) / NS)
        if got is None:
            self.clock.wait_until(step)  # at once, unless the bus itself does not let time pass
            return
        reply = decode(got[0])
        if isinstance(reply, PropertyReply):
            self.properties[reply.node, reply.property] = reply.value
            self.answers[reply.node, reply.property] += 1
        elif isinstance(reply, Position):
            self.positions[reply.node] = reply.counts
