"""Nodes of an arm that hold properties, to be started up."""

from collections import deque

import can

from deploy.bus.bus import Bus
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.puck import codec, properties
from deploy.puck.codec import decode
from deploy.puck.frame import Frame
from deploy.puck.messages import Set
from deploy.puck.pendant import Pendant
from deploy.wam.startup import startup
from tests.deploy.pendants import encode_pendant

MS = 1_000_000
HOME_COUNTS = [0, -36833, 36832, -36728]  # wam.md §3.2
PENDANT = Pendant("none", False, True, "0", "SAFE", "SAFE", "SAFE", "SAFE", "SAFE")
KINDS = {1: "motor", 2: "motor", 3: "motor", 4: "motor", 8: "force", 10: "safety"}


class FakeArm(can.BusABC):
    """Nodes that hold properties and answer at once; time is what the bus or the caller lets pass."""

    def __init__(self, zero=1, version=150):
        super().__init__(channel="fake")
        self._is_shutdown = True  # nothing to give back
        self.ns, self.queue, self.orders, self.silent, self.lose, self.deaf = 0, deque(), [], set(), 0, set()
        self.asked = 0
        self.versions = {node: version for node in (1, 2, 3, 4)} | {8: 24, 10: 197}
        self.values = {node: {"VERS": v, "STAT": 0} for node, v in self.versions.items()}
        for node in (1, 2, 3, 4):
            puck = {"ROLE": 0x100, "PIDX": node, "CTS": 4096, "IPNM": 2700, "MT": 4860, "MODE": 2, "MECH": 0}
            self.values[node] |= puck | {"GRPA": 0, "GRPB": 1, "GRPC": 4, "P": HOME_COUNTS[node - 1]}
        self.values[8] |= {"ROLE": 6, "FT": 0}
        safety = {"ROLE": 2, "MODE": 1, "ZERO": zero, "PEN": encode_pendant(PENDANT), "IFAULT": 0, "STAT": 2}
        self.values[10] |= safety | {"VL1": 1, "VL2": 4096, "TL1": 1, "TL2": 5204, "DEF": 0, "LOAD": 0}

    # the clock
    def now(self):
        return self.ns

    def wait_until(self, deadline_ns):
        self.ns = max(self.ns, deadline_ns)

    # the driver
    def _recv_internal(self, timeout):
        if self.queue:
            frame = self.queue.popleft()
            return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False), False
        return None, False

    def send(self, msg, timeout=None):
        frame = Frame(msg.arbitration_id, bytes(msg.data))
        said = decode(frame)
        nodes = (1, 2, 3, 4) if frame.id & 0x400 else (frame.id,)
        for node in nodes:
            if node not in self.values or node in self.silent:
                continue
            names = {properties.number(name, KINDS[node], self.versions[node]): name for name in self.values[node]}
            name = names.get(said.property)
            if isinstance(said, Set):
                self.orders.append((self.ns, node, name, said.value))
                if name is not None and (node, name) not in self.deaf:
                    self.values[node][name] = said.value
            elif name is not None:
                self.asked += 1
                self.answer(node, name, said.property)

    def answer(self, node, name, number):
        if self.lose:
            self.lose -= 1
            return
        value = self.values[node][name]
        if name == "P":
            self.queue.append(codec.encode_position(node, value))
        else:
            self.queue.append(codec.encode_property(node, number, value))

    def awake(self):
        for values in self.values.values():
            values["STAT"] = 2
        return self

    def told(self, *names):
        return [(node, name, value) for _, node, name, value in self.orders if name in names]


def start(fake, **settings):
    said = []
    arm = startup(Bus(fake, fake.now), fake, Mounted(CanSensor()), report=said.append, **settings)
    return arm, said
