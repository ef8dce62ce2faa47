"""An arm on a wire whose frames come when a test says so."""

from collections import deque

import can

from deploy.bus.bus import Bus
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.puck.pendant import Pendant
from deploy.wam.arm import WamArm
from deploy.wam.pucks import PuckInfo, Pucks

MS = 1_000_000
START = (100, -200, 300, -400)
PENDANT = Pendant("none", False, True, "0", "SAFE", "SAFE", "SAFE", "SAFE", "SAFE")
FORCE, MOMENT = codec.encode_force((0.0, 0.0, 5.0)), codec.encode_moment((0.0, 0.0, 0.0))


class Wire(can.BusABC):
    """A driver with a queue of frames to come, each with the time that it comes at."""

    def __init__(self):
        super().__init__(channel="wire")
        self._is_shutdown = True  # nothing to give back
        self.now_ns, self.queue, self.sent, self.refuse = 0, deque(), [], False
        self.errors = []

    def now(self):
        return self.now_ns

    def put(self, frame, at=None):
        self.queue.append((self.now_ns if at is None else at, frame))

    def _recv_internal(self, timeout):
        if self.errors:
            return self.errors.pop(), False
        if not self.queue or self.queue[0][0] > self.now_ns + timeout * 1e9:
            self.now_ns += int(timeout * 1e9)
            return None, False
        due, frame = self.queue.popleft()
        self.now_ns = max(self.now_ns, due)
        return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False), False

    def send(self, msg, timeout=None):
        if self.refuse:
            raise can.CanOperationError("full", 105)
        self.sent.append(Frame(msg.arbitration_id, bytes(msg.data)))


class Rig:
    """An arm on a wire, one cycle a call."""

    def __init__(self, **settings):
        self.wire = Wire()
        infos = tuple(PuckInfo(n, n, 150, 0, 4096, 2700, 4860) for n in (1, 2, 3, 4))
        self.bus = Bus(self.wire, self.wire.now)
        self.arm = WamArm(self.bus, Pucks(infos), Mounted(CanSensor()), START, safety_version=197, **settings)

    def cycle(self, *frames, early=(), late=()):
        """Frames before the question, in time, and after the deadline."""
        for frame in early:
            self.wire.put(frame)
        assert self.arm.request()
        start = self.wire.now_ns
        for i, frame in enumerate(frames):
            self.wire.put(frame, start + 100_000 + 10_000 * i)
        reading = self.arm.collect(start + 600_000)
        for frame in late:
            self.wire.put(frame)
        self.wire.now_ns = max(self.wire.now_ns, start + MS)
        return reading


def positions(counts=START, nodes=(1, 2, 3, 4)):
    return [codec.encode_position(node, counts[node - 1]) for node in nodes]


def whole(counts=START):
    return [*positions(counts), FORCE, MOMENT]


def moved(by):
    return tuple(each + by for each in START)
