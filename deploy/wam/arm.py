"""Traffic of one cycle: requests, replies that come in time, ages of what is missing, the torque frame."""

from collections.abc import Sequence
from typing import Final

from deploy.bus.bus import MOST_AT_ONCE, Bus
from deploy.durations import cycles
from deploy.force.sensor import ForceSensor
from deploy.puck import properties
from deploy.puck.codec import BROADCAST, GROUPS, SAFETY_MODULE, decode, get, pack_torques, position_counts, set_value
from deploy.puck.frame import Frame
from deploy.puck.messages import PropertyReply
from deploy.puck.pendant import Pendant, decode_pendant
from deploy.wam.dialogue import Dialogue
from deploy.wam.pucks import Pucks
from deploy.wam.reading import Reading

DOUBT: Final = 0.02
"""Time after a missing position in which it may still come [s]; older ones would have stopped the arm anyway."""
POLL_EVERY: Final = 0.005
"""Time between two questions about states [s]; there are four in turn, so 50 Hz each (wam.md §6)."""
BACKLOG: Final = 256
"""Frames that are read before the question is asked: ten milliseconds of a full bus, in the time of one cycle."""
LONG_AGO: Final = 1_000_000
"""An age in cycles for what has never come."""


class WamArm:
    """A started arm; `deploy.wam.startup.startup` makes it.

    In a cycle come `request`, `collect`, then the torques. Replies do not say which question they answer, so what is
    there before the question is asked is late and never taken for fresh: at best it is the one position that the last
    cycle missed, and as old as that, until a fresh one comes. After a missing reply, cycles wait for a second one
    until their time is up, and two different ones in a cycle count as none, since either may be the late one.

    Attributes:
        pucks: What the pucks said.
        counts: The last accepted ones (4,), whatever their age.
        cycle: How many there have been.
        late: Position replies that came after their cycle.
        duplicates: Position replies that repeated another of the same cycle.
        doubtful: Cycles of a motor in which two different positions came.
        jumps: Positions refused because they were more than a quarter of a motor's turn away.
        malformed: Frames from our nodes that are none of the protocol.
    """

    def __init__(
        self,
        bus: Bus,
        pucks: Pucks,
        sensor: ForceSensor,
        counts: Sequence[int],
        safety_version: int,
        T_s: float = 1e-3,
    ) -> None:
        """Begin with positions already known.

        Args:
            bus: With its traffic in our hands alone.
            pucks: As read.
            sensor: Of the force; a `Mounted` one, so that forces are those on the tissue.
            counts: Of the motors (4,), to judge the first jump by.
            safety_version: Of the safety module's firmware.
            T_s: Time between two cycles [s].
        """
        self.bus, self.pucks, self.sensor = bus, pucks, sensor
        self.counts = list(counts)
        self.cycle = self.late = self.duplicates = self.doubtful = self.jumps = self.malformed = 0
        self._slots = {GROUPS["position"] | node << 5: i for i, node in enumerate(pucks.nodes)}
        self._motor = {node: i for i, node in enumerate(pucks.nodes)}
        self._largest_jump = tuple(info.counts_per_turn // 4 for info in pucks.infos)
        self._torque_property = pucks.number("T")
        self._positions = get(GROUPS["wam"], pucks.number("P"))
        self._pen = properties.number("PEN", "safety", safety_version)
        self._mode, self._status = pucks.number("MODE"), pucks.infos[0].number("STAT")
        mode, pen = get(SAFETY_MODULE, self._mode), get(SAFETY_MODULE, self._pen)
        own = [get(node, number) for node in pucks.nodes for number in (self._status, self._mode)]
        self._polls = [each for i in range(4) for each in (mode, own[2 * i], pen, own[2 * i + 1])]
        self._poll_every, self._doubtful = cycles(POLL_EVERY, T_s), cycles(DOUBT, T_s)
        self._new: list[int | None] = [None] * 4
        self._late: list[int | None] = [None] * 4
        self._answers, self._doubt, self._ages = [1] * 4, [0] * 4, [0] * 4
        self._waiting = 0
        self._force_age = self._safety_age = LONG_AGO
        self._safety_mode: int | None = None
        self._pendant: Pendant | None = None
        self._ask_mode = False
        self._puck_status = [properties.STAT_READY] * 4
        self._puck_mode: list[int | None] = [None] * 4
        self._puck_age = [0] * 4
        self._other: list[PropertyReply] = []

    def moved(self, talk: Dialogue) -> int | None:
        """The first motor (0–3) that stands elsewhere than before the cycles, None if none does.

        Args:
            talk: On this arm's bus.

        Raises:
            BusError: A puck does not tell its position.
        """
        counts_now = talk.told_positions(self._positions, self.pucks.nodes)
        jumps = zip(counts_now, self.counts, self._largest_jump, strict=True)
        return next((i for i, (now, before, largest) in enumerate(jumps) if abs(now - before) > largest), None)

    def request(self) -> bool:
        """Begin a cycle: ask for positions and force, now and then for a state; False if the bus refuses."""
        self._other.clear()
        late: list[int | None] = [None] * 4
        self._late = late
        for frame, _ in self.bus.drain(BACKLOG):
            if (slot := self._slots.get(frame.id)) is not None:
                self.late += 1
                if not (self._answers[slot] or self._doubt[slot]):
                    counts = position_counts(frame.data)
                    late[slot] = None if counts is None else self._believed(slot, counts)
                self._answers[slot] += 1  # the missing one has come, if one was missing
                self._doubt[slot] = 0
            elif not frame.id & 0x418 == 0x408:  # nor a late force, of the groups 8 to 15
                self._take_property(frame)
        self.cycle += 1
        self._waiting = 4
        for i in range(4):
            doubt = self._doubt[i]
            self._doubt[i] = (doubt - 1 if doubt else 0) if self._answers[i] else self._doubtful
            self._waiting += self._doubt[i] > 0
            self._answers[i], self._new[i] = 0, None
        # After an error few frames are still tried: they are for letting the arm go, not for questions.
        sent = self.bus.state == "active" and self.bus.send(self._positions)
        for frame in self.sensor.request():
            sent = sent and self.bus.send(frame)
        if self._ask_mode:
            self._ask_mode = False
            sent = sent and self.bus.send(self._polls[0])
        elif self.cycle % self._poll_every == 0:
            sent = sent and self.bus.send(self._polls[self.cycle // self._poll_every % len(self._polls)])
        return sent

    def collect(self, deadline_ns: int) -> Reading:
        """Take the answers until all are here or the time is up [ns on the bus's clock]."""
        bus, now, slots, sensor = self.bus, self.bus.now, self._slots, self.sensor
        # What was not even read yet would be taken for an answer: such a cycle goes without any.
        overdue = 0 if bus.dry else MOST_AT_ONCE
        while (self._waiting or not sensor.ready) and overdue < MOST_AT_ONCE:
            left = deadline_ns - now()
            overdue += left <= 0
            got = bus.receive(left * 1e-9 if left > 0 else 0.0)
            if got is None:
                break
            slot = slots.get(got[0].id)
            if slot is not None:
                self._take_position(slot, got[0].data)
            elif not sensor.feed(got[0]):
                self._take_property(got[0])
        return self._reading()

    def torque_frame(self, joint_torque: Sequence[float]) -> Frame:
        """The frame for joint torques [N m] (4,); whoever sends it by `Bus.send` has it checked before.

        Raises:
            ValueError: A torque is not finite or does not fit: the clamps come before.
        """
        try:
            return pack_torques(self.pucks.units(joint_torque), self._torque_property)
        except OverflowError:
            raise ValueError(f"joint torques {tuple(joint_torque)} are not finite") from None

    def idle_frames(self) -> tuple[Frame, Frame]:
        """Frames that lower the arm's state: every puck to idle, and the safety module to idle."""
        pucks = set_value(GROUPS["wam"], self._mode, properties.MODE_IDLE)
        return pucks, set_value(SAFETY_MODULE, self._mode, properties.SAFETY_IDLE)

    def _take_position(self, slot: int, data: bytes) -> None:
        counts = position_counts(data)
        if counts is None:
            self.malformed += 1
            return
        self._answers[slot] += 1
        if self._answers[slot] == 1:
            self._waiting -= 1
            self._new[slot] = self._believed(slot, counts)
            return
        if self._doubt[slot]:
            self._doubt[slot] = 0
            self._waiting -= 1
        if counts == self._new[slot]:
            self.duplicates += 1
        else:
            self.doubtful += self._new[slot] is not None
            self._new[slot] = None

    def _believed(self, slot: int, counts: int) -> int | None:
        """A motor's counts, None where they are too far away."""
        if -self._largest_jump[slot] <= counts - self.counts[slot] <= self._largest_jump[slot]:
            return counts
        self.jumps += 1
        return None

    def _take_property(self, frame: Frame) -> None:
        if frame.id == BROADCAST:
            # What it says is unpublished, but that it speaks to all is reason enough to ask for its mode at once.
            self._ask_mode = True
            return
        reply = decode(frame)
        if not isinstance(reply, PropertyReply):
            self.malformed += 1
            return
        if len(self._other) < MOST_AT_ONCE:
            self._other.append(reply)
        if reply.node == SAFETY_MODULE:
            self._safety_age = -1
            if reply.property == self._mode:
                self._safety_mode = reply.value
            elif reply.property == self._pen:
                self._pendant = decode_pendant(reply.value)
        elif (motor := self._motor.get(reply.node)) is not None:
            if reply.property == self._status:
                self._puck_status[motor], self._puck_age[motor] = reply.value, -1
            elif reply.property == self._mode:
                self._puck_mode[motor], self._puck_age[motor] = reply.value, -1

    def _reading(self) -> Reading:
        ages, new = self._ages, self._new
        for i in range(4):
            counts, age = (new[i], 0) if new[i] is not None else (self._late[i], 1)
            if counts is None:
                ages[i] += 1
            else:
                self.counts[i] = new[i] = counts
                ages[i] = age
        wrench = self.sensor.read()
        self._force_age = self._force_age + 1 if wrench is None else 0
        self._safety_age += 1
        self._puck_age = [age + 1 for age in self._puck_age]
        return Reading(
            tuple(new),
            tuple(ages),
            wrench and wrench.force,
            self._force_age,
            wrench.flags if wrench else 0,
            self._safety_mode,
            self._pendant,
            self._safety_age,
            tuple(self._puck_status),
            tuple(self._puck_mode),
            tuple(self._other),
            tuple(self._puck_age),
        )
