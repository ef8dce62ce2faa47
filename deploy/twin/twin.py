"""The twin: frames from the host in, frames to the host out, time in steps of a millisecond.

Positions and forces are those of the last whole millisecond, as on an arm that samples when it is asked. A torque acts
`delay` milliseconds after the step in which its frame came.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from deploy.puck import codec, messages
from deploy.puck.frame import Frame
from deploy.twin.bus_timing import BabblingNode, BusTiming
from deploy.twin.device import RESET, Device
from deploy.twin.faults import ENCODERS, NOT_FINITE, Fault, parse
from deploy.twin.force_torque import ForceTorque
from deploy.twin.pucks import TORQUE, Puck
from deploy.twin.readings import Readings
from deploy.twin.safety_module import ESTOP, IDLE, SafetyModule
from deploy.twin.settings import TwinSettings
from deploy.twin.world import Truth, TwinPhysics
from jaxmpc.law.vectors import Vector3, Vector4

MILLISECOND = 1_000_000
"""[ns]"""
PUCK_ERROR = 2
"""ERROR of a puck with a fault (chosen here)."""
_GRAVITY = np.array([0.0, 0.0, 9.805])
_NO_MOMENT = codec.encode_moment((0.0, 0.0, 0.0))


class Twin:
    """A robot that speaks the WAM's protocol.

    Attributes:
        counters: How many frames came, went, were lost; and what a host did that it must not do.
    """

    def __init__(self, settings: TwinSettings | None = None) -> None:
        """Switch the robot on.

        Raises:
            InputError: A fault's text is wrong.
        """
        self.settings = settings or TwinSettings()
        self.faults = tuple(parse(text) for text in self.settings.faults)
        self.counters: Counter[str] = Counter()
        self.tick = 0
        self.world = TwinPhysics(self.settings)
        self.pucks = tuple(Puck(node, self.settings) for node in codec.PUCKS)
        self.safety = SafetyModule(self.settings)
        self.sensor = ForceTorque(self.settings)
        devices: tuple[Device, ...] = (*self.pucks, self.sensor, self.safety)
        self._nodes = {device.node: device for device in devices}
        self._asked = self.sensor.number["FT"], self.sensor.number["A"]
        random = [np.random.default_rng([self.settings.seed, 2, i]) for i in range(7)]
        self._readings = Readings(self.pucks, self.sensor, self.faults, random[:5])
        self._wire = BusTiming(self.settings.bit_rate, self.faults, random[5])
        self._babbler, self._mode = BabblingNode(self.faults, random[6]), self.safety.mode
        self._events = sorted((f for f in self.faults if f.is_event), key=lambda f: f.start)
        self._off = [f for f in self.faults if f.target == "bus" and f.word == "off"]
        self._not_finite = [f for f in self.faults if f.word in NOT_FINITE]
        self._sample()
        self._happen()

    @property
    def now(self) -> float:
        """Time [s]."""
        return 1e-3 * self.tick

    @property
    def now_ns(self) -> int:
        """Time [ns]."""
        return MILLISECOND * self.tick

    @property
    def bus_off(self) -> bool:
        """Whether the host's controller is off the bus: nothing comes or goes."""
        return bool(self._off) and any(fault.active(self.now) for fault in self._off)

    def truth(self) -> Truth:
        """True state, which no controller can know."""
        return self.world.truth()

    def receive(self, frame: Frame, at_ns: int | None = None) -> None:
        """Take a frame from the host.

        Args:
            frame: The frame.
            at_ns: When, within the running millisecond, where replies take their time on the wire.
        """
        self.counters["received"] += 1
        if self.bus_off:
            self.counters["received while bus-off"] += 1
            return
        at = max(self.now_ns, at_ns or 0)
        self._wire.carry(frame, at)
        copies = self._wire.copies(("commands",), self.now)
        self.counters["lost"] += not copies
        for late in copies:
            if late > 0.0:
                self._wire.delay(frame, at + round(1e9 * late))
            else:
                self._obey(frame, at)

    def take(self, until_ns: int | None = None) -> list[Frame]:
        """Frames to the host that are there by now, or by a time within the running millisecond [ns]."""
        until = self.now_ns if until_ns is None else until_ns
        self._obey_late(min(until, self.now_ns + MILLISECOND - 1))  # what comes with the next sample meets that one
        due = self._wire.take(until)
        if due:
            if self.bus_off:
                due.clear()
            self.counters["sent"] += len(due)
        return due

    def next_ns(self) -> int | None:
        """Time at which the next frame will be there, or a late one from the host [ns], as far as known."""
        return self._wire.next()

    def advance(self) -> None:
        """Let a millisecond go by."""
        self.safety.advance(self.now)
        self._follow_safety()
        a, b, c, d = self.pucks
        braked = (not a.driving, not b.driving, not c.driving, not d.driving)
        self.world.advance((a.torque, b.torque, c.torque, d.torque), braked)
        self.tick += 1
        self._sample()
        self._happen()
        self._obey_late(self.now_ns)

    def press(self, button: str) -> None:
        """Press a button of the pendant: "activate", "idle" or "e-stop".

        Raises:
            InputError: There is no such button.
        """
        self.safety.press(button, self.now)
        self._follow_safety()

    def carry(self, q: Vector4 | None = None, seconds: float = 2.0) -> None:
        """Somebody carries the idle arm to joint angles [rad], by default above the heart, and holds it there."""
        self.world.place(q or self.world.posture, seconds)
        self._sample()

    def force_hook(self, force: Vector3) -> Vector3:
        """A force between a sensor's driver and a controller: itself, or NaN or infinity while such a fault lasts."""
        for fault in self._not_finite:
            if fault.active(self.now):
                return (NOT_FINITE[fault.word],) * 3
        return force

    def _sample(self) -> None:
        self._readings.sample(self.world.q, self.world.measured, self.tick)

    def _happen(self) -> None:
        """Begin the faults that are events, and post a babbling node's frames of the coming millisecond."""
        while self._events and self._events[0].start <= self.now + 1e-9:
            self._event(self._events.pop(0))
        for frame in self._babbler.frames(self.now):
            self._wire.post(frame, self.now_ns)

    def _event(self, fault: Fault) -> None:
        if fault.target == "pendant":
            self.press(fault.word)
            return
        puck = self.pucks[int(fault.target[-1]) - 1]
        if fault.word == "reset":
            puck.reset()
        elif fault.word == "off":
            puck.powered = False
        else:
            puck.fail(PUCK_ERROR)
            if fault.word == "fault":
                self._reply(codec.encode_property(puck.node, puck.number["STAT"], puck.stat), self.now_ns)

    def _obey_late(self, until: int) -> None:
        """Obey the frames of the host that were under way until a time [ns]."""
        for at, frame in self._wire.delayed(until):
            if not self.bus_off:
                self._obey(frame, max(at, self.now_ns))

    def _obey(self, frame: Frame, at: int) -> None:
        message = codec.decode(frame)
        if isinstance(message, messages.Torques):
            if message.property == codec.TORQUE:
                for puck in self.pucks:
                    index = puck.get(puck.number["PIDX"])
                    if index and puck.answers(self.now) and 1 <= index <= 4:
                        puck.command(message.units[index - 1])
                self.safety.heard_torques(message.units, self.now)
                self._follow_safety()
        elif isinstance(message, messages.Get):
            for device in self._addressed(message.to):
                self._answer(device, message.property, at)
        elif isinstance(message, messages.Set):
            for device in self._addressed(message.to):
                if isinstance(device, Puck) and (message.property, message.value) == (device.number["MODE"], TORQUE):
                    self.counters["torque mode set by the host"] += 1
                device.set(message.property, message.value, self.now)
            self._follow_safety()
        else:
            self.counters["not understood"] += 1

    def _addressed(self, to: int) -> Sequence[Device]:
        """The nodes that a host's identifier reaches and that listen."""
        now = self.now
        if to & codec.GROUP:
            group = to & 0x1F
            return [puck for puck in self.pucks if group in puck.groups and puck.answers(now)]
        device = self._nodes.get(to)
        return (device,) if device is not None and device.answers(now) else ()

    def _answer(self, device: Device, number: int, at: int) -> None:
        if isinstance(device, Puck) and number == device.number["P"] and device.stat != RESET:
            raw = self._readings.counts[device.node - 1]
            if raw is not None:
                wrapped = (device.position(raw) + codec.LARGEST_POSITION) % (2 * codec.LARGEST_POSITION)
                counts = wrapped - codec.LARGEST_POSITION
                self.safety.heard_position(device.node, counts, self.now)
                self._follow_safety()
                frame = codec.encode_position(device.node, counts)
                self._reply(frame, at, "positions", ENCODERS[device.node - 1])
        elif device is self.sensor and device.stat == RESET and number in self._asked:
            return
        elif device is self.sensor and number == self._asked[0]:
            if self._readings.force is not None:
                force, flags = self.sensor.reading(self._readings.force, self.world.orientation)
                self._reply(codec.encode_force(force, flags), at, "force")
                self._reply(_NO_MOMENT, at, "force")
        elif device is self.sensor and number == self._asked[1]:
            self._reply(codec.encode_acceleration(self.sensor.turned(_GRAVITY, self.world.orientation)), at, "force")
        elif (value := device.get(number)) is not None:
            self._reply(codec.encode_property(device.node, number, value), at)

    def _reply(self, frame: Frame, at: int, *targets: str) -> None:
        """Send a frame to the host, which faults may lose, delay or double."""
        copies = self._wire.copies(("frames", *targets), self.now)
        self.counters["lost"] += not copies
        for late in copies:
            self._wire.post(frame, at + round(1e9 * late) if late else at)

    def _follow_safety(self) -> None:
        """Give pucks and sensor the mode and the power of the safety module."""
        mode, before = self.safety.mode, self._mode
        if mode == before:
            return
        self._mode = mode
        for device in (*self.pucks, self.sensor):
            if mode == ESTOP:
                device.powered = False
            elif before == ESTOP:
                device.powered = True
                device.reset()
        if before == ESTOP:
            self.safety.values[self.safety.number["ZERO"]] = 0
        if mode != ESTOP:
            number = self.safety.number["MODE"]
            wanted = 0 if mode == IDLE else TORQUE
            for puck in self.pucks:
                if puck.answers(self.now):
                    puck.set(puck.number["MODE"], wanted, self.now)
            self._reply(Frame(codec.BROADCAST, bytes((codec.SET | number, 0, wanted, 0, 0, 0))), self.now_ns)
