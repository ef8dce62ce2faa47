import gc
import random
import sys
from collections import deque

import can
import pytest

from deploy.bus.bus import MOST_AT_ONCE, Bus
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.puck import codec, messages
from deploy.puck.codec import GROUPS, decode
from deploy.puck.frame import Frame
from deploy.puck.messages import PropertyReply, Torques
from deploy.puck.pendant import Pendant
from deploy.wam.arm import DOUBT, WamArm
from deploy.wam.pucks import PuckInfo, Pucks
from tests.deploy.pendants import encode_pendant

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


@pytest.fixture
def rig():
    return Rig()


def test_a_whole_cycle(rig):
    reading = rig.cycle(*whole(moved(3)))
    assert rig.wire.sent == [Frame(0x404, b"\x30"), Frame(0x008, b"\x36")]
    assert reading.counts == moved(3)
    assert reading.position_age == (0, 0, 0, 0)
    assert reading.force == (0.0, 0.0, -5.0)
    assert (reading.force_age, reading.force_flags) == (0, 0)
    assert reading.other == ()
    assert rig.arm.counts == list(moved(3))


def test_the_cycle_goes_on_as_soon_as_everything_is_here(rig):
    rig.arm.request()
    for i, frame in enumerate(whole()):
        rig.wire.put(frame, 10_000 * i)
    rig.arm.collect(600_000)
    assert rig.wire.now_ns == 50_000


def test_what_does_not_come_ages_in_cycles(rig):
    rig.cycle(*whole())
    for age in (1, 2, 3):
        reading = rig.cycle(*positions(moved(age), (1, 2, 4)))
        assert reading.counts == (START[0] + age, START[1] + age, None, START[3] + age)
        assert reading.position_age == (0, 0, age, 0)
        assert (reading.force, reading.force_age) == (None, age)
    assert rig.arm.counts[2] == START[2]
    assert rig.cycle(*whole(moved(4))).position_age == (0, 0, 0, 0)


def test_a_force_that_never_came_is_ancient(rig):
    assert rig.cycle(*positions()).force_age > 1000


def test_a_late_reply_is_as_old_as_it_is_and_never_taken_for_fresh(rig):
    rig.cycle(*whole())
    reading = rig.cycle(*positions(moved(1), (1, 2, 3)), FORCE, MOMENT, late=positions(moved(1), (4,)))
    assert reading.position_age == (0, 0, 0, 1)
    reading = rig.cycle(FORCE, MOMENT)  # of this cycle nothing: the late one stands in as that of the last
    assert reading.counts == (None, None, None, moved(1)[3])
    assert reading.position_age == (1, 1, 1, 1)
    assert rig.arm.late == 1
    assert rig.cycle(*whole(moved(3))).position_age == (0, 0, 0, 0)


def test_replies_that_are_always_a_cycle_late_are_a_cycle_old(rig):
    rig.cycle(*whole())
    rig.cycle(FORCE, MOMENT, late=positions(moved(1)))
    for k in range(2, 100):
        reading = rig.cycle(FORCE, MOMENT, late=positions(moved(k)))
        assert (reading.counts, reading.position_age) == (moved(k - 1), (1, 1, 1, 1))


def test_a_fresh_reply_wins_over_a_late_one(rig):
    rig.cycle(*whole())
    rig.cycle(FORCE, MOMENT, late=positions(moved(1)))
    reading = rig.cycle(*whole(moved(2)))
    assert (reading.counts, reading.position_age) == (moved(2), (0, 0, 0, 0))


def test_a_reply_that_may_be_older_than_the_last_cycle_is_never_used(rig):
    rig.cycle(*whole())
    rig.cycle(FORCE, MOMENT)
    rig.cycle(FORCE, MOMENT, late=positions(moved(1)))  # of the first or of the second question
    reading = rig.cycle(FORCE, MOMENT)
    assert (reading.counts, reading.position_age) == ((None,) * 4, (3, 3, 3, 3))


def test_a_late_reply_that_nobody_missed_is_never_used(rig):
    rig.cycle(*whole(), late=positions(moved(7)))
    assert rig.cycle(FORCE, MOMENT).counts == (None,) * 4


@pytest.mark.parametrize("by", [1025, -1025])
def test_a_late_jump_is_refused(rig, by):
    rig.cycle(FORCE, MOMENT, late=positions(moved(by)))
    assert rig.cycle(FORCE, MOMENT).counts == (None,) * 4
    assert rig.arm.jumps == 4


def test_a_late_force_is_never_used(rig):
    rig.cycle(*positions(), late=(FORCE, MOMENT))
    assert rig.cycle(*positions()).force is None
    assert rig.arm.malformed == 0


@pytest.mark.parametrize("delay", [1, 3, 10])
@pytest.mark.parametrize("stale_first", [True, False])
def test_of_a_late_and_a_fresh_reply_in_one_cycle_neither_is_used(rig, delay, stale_first):
    rig.cycle(*whole())
    rig.cycle(*positions(moved(1), (1, 2, 3)), FORCE, MOMENT)
    for k in range(2, delay + 1):
        rig.cycle(*whole(moved(k)))
    before = rig.arm.counts[3]
    stale, fresh = codec.encode_position(4, START[3] + 1), codec.encode_position(4, START[3] + delay + 1)
    pair = (stale, fresh) if stale_first else (fresh, stale)
    reading = rig.cycle(*positions(moved(delay + 1), (1, 2, 3)), FORCE, MOMENT, *pair)
    assert reading.counts[3] is None
    assert rig.arm.doubtful == 1
    assert rig.arm.counts[3] == before  # nothing older has replaced it
    # the late one has come: from here on nobody waits for another
    rig.cycle(*whole(moved(delay + 2)))
    assert rig.arm.counts == list(moved(delay + 2))


def test_doubt_ends_and_with_it_the_waiting(rig):
    rig.cycle(*whole())
    rig.cycle(*positions(moved(1), (1, 2, 3)), FORCE, MOMENT)
    waited = []
    for _ in range(DOUBT + 5):
        start = rig.wire.now_ns
        rig.arm.request()
        for i, frame in enumerate(whole()):
            rig.wire.put(frame, start + 10_000 * i)
        rig.arm.collect(start + 600_000)
        waited.append(rig.wire.now_ns - start)
        rig.wire.now_ns = start + MS
    assert waited == [600_000] * DOUBT + [50_000] * 5


def test_duplicates_are_counted_and_harmless(rig):
    first, *others = whole()
    reading = rig.cycle(first, first, first, *others)
    assert reading.counts == START
    assert rig.arm.duplicates == 2


def test_reordered_replies_are_as_good(rig):
    assert rig.cycle(*reversed(whole())).counts == START


@pytest.mark.parametrize(
    ("by", "accepted"), [(1024, True), (-1024, True), (1025, False), (-1025, False), (2**20, False)]
)
def test_jumps_beyond_a_quarter_turn_are_refused(rig, by, accepted):
    rig.cycle(*whole())
    jumped = (START[0], START[1] + by, START[2], START[3])
    for age in range(1, 4):
        reading = rig.cycle(*whole(jumped))
        assert reading.counts[1] == (jumped[1] if accepted else None)
        assert reading.position_age[1] == (0 if accepted else age)
    assert rig.arm.jumps == (0 if accepted else 3)


def test_wrong_lengths_and_foreign_frames_are_counted(rig):
    wrong = [Frame(0x423, bytes(n)) for n in (0, 1, 2, 4, 5, 7, 8)]
    strange = [Frame(0x426, b"\x01\x02"), Frame(0x020, b""), Frame(0x540, b"\x01\x02")]
    reading = rig.cycle(*wrong, *strange, Frame(0x7E3, bytes(3)), *whole())
    assert reading.counts == START
    assert rig.arm.malformed == 9  # the safety module's broadcast is none of ours to understand
    assert rig.bus.counters.foreign == 1


def test_a_babbling_puck_does_not_hold_the_cycle(rig):
    rig.arm.request()
    for i in range(3000):
        rig.wire.put(codec.encode_position(1, START[0]), 10_000 * i)
    rig.arm.collect(600_000)
    assert 600_000 <= rig.wire.now_ns <= 600_000 + 10_000 * MOST_AT_ONCE
    assert len(rig.wire.queue) > 2800


def test_answers_behind_a_backlog_are_not_taken_for_fresh(rig):
    rig.cycle(*whole())
    babble = [Frame(0x7E3, bytes(3))] * 1000
    for k in range(3):  # read off bit by bit, and meanwhile nothing is believed
        reading = rig.cycle(early=(*babble, *positions(moved(1))) if k == 0 else ())
        assert reading.counts == (None,) * 4
        assert reading.position_age == (k + 1,) * 4
    assert rig.cycle(*whole(moved(5))).counts == moved(5)
    assert rig.arm.late == 4


def test_after_an_overrun_what_is_there_is_taken_without_waiting(rig):
    rig.arm.request()
    for frame in whole():
        rig.wire.put(frame)
    rig.wire.now_ns += 5 * MS
    reading = rig.arm.collect(600_000)
    assert reading.counts == START
    assert reading.force is not None


def test_states_are_polled_in_turn_at_50_hz_each(rig):
    for _ in range(1000):
        rig.cycle(*whole())
    polls = [decode(frame) for frame in rig.wire.sent if frame.id in (1, 2, 3, 4, 10)]
    asked = {(poll.to, poll.property): polls.count(poll) for poll in polls}
    assert asked.pop((10, 8)) == asked.pop((10, 43)) == 50
    assert set(asked) == {(node, number) for node in (1, 2, 3, 4) for number in (5, 8)}
    assert sum(asked.values()) == 100
    assert all(12 <= times <= 13 for times in asked.values())
    assert rig.wire.sent.count(Frame(0x404, b"\x30")) == rig.wire.sent.count(Frame(0x008, b"\x36")) == 1000


def test_states_surface(rig):
    reading = rig.cycle(*whole())
    assert (reading.safety_mode, reading.pendant, reading.puck_mode) == (None, None, (None,) * 4)
    assert reading.puck_status == (2,) * 4
    told = [
        codec.encode_property(10, 8, 2, short=True),
        codec.encode_property(10, 43, encode_pendant(PENDANT)),
        codec.encode_property(3, 5, 1),
        codec.encode_property(2, 8, 2),
        codec.encode_property(4, 4, 7),
    ]
    reading = rig.cycle(*told, *whole())
    assert reading.safety_mode == 2
    assert reading.pendant == PENDANT
    assert reading.safety_age == 0
    assert reading.puck_status == (2, 2, 1, 2)
    assert reading.puck_mode == (None, 2, None, None)
    assert reading.other == tuple(decode(frame) for frame in told)
    assert reading.other[0] == PropertyReply(10, 8, 2)
    reading = rig.cycle(*whole(), early=(codec.encode_property(10, 8, 0),))  # states are not of any cycle
    assert (reading.safety_mode, reading.safety_age, len(reading.other)) == (0, 0, 1)
    reading = rig.cycle(*whole())
    assert (reading.safety_mode, reading.safety_age, reading.other) == (0, 1, ())


def test_torques_are_packed_as_the_pucks_want_them(rig):
    frame = rig.arm.torque_frame((1.0, -2.0, 0.5, 3.0))
    assert decode(frame) == Torques(rig.arm.pucks.units((1.0, -2.0, 0.5, 3.0)), 42)
    assert rig.arm.torque_frame((0.0, 0.0, 0.0, 0.0)).data == b"\xaa" + bytes(7)
    assert rig.wire.sent == []  # whoever checks it sends it


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e6])
def test_torques_that_are_none_are_refused(rig, value):
    with pytest.raises(ValueError):  # noqa: PT011  # the words differ with the value
        rig.arm.torque_frame((0.0, 0.0, 0.0, value))


def test_idle_frames_only_lower_the_state(rig):
    assert [decode(frame) for frame in rig.arm.idle_frames()] == [
        messages.Set(GROUPS["wam"], 8, 0),
        messages.Set(codec.SAFETY_MODULE, 8, 1),
    ]


def test_a_bus_that_takes_nothing_is_told(rig):
    rig.wire.refuse = True
    assert not rig.arm.request()
    assert rig.bus.state == "error"
    assert rig.arm.collect(600_000).position_age == (1, 1, 1, 1)


def test_one_reply_in_a_thousand_lost_is_counted_exactly(rig):
    draw = random.Random(0)
    lost = aged = 0
    for _ in range(3000):
        frames = [frame for frame in whole() if draw.random() >= 1e-3 or frame in (FORCE, MOMENT)]
        lost += 6 - len(frames)
        aged += sum(age > 0 for age in rig.cycle(*frames).position_age)
    assert aged == lost > 5
    assert (rig.arm.late, rig.arm.doubtful, rig.arm.jumps) == (0, 0, 0)


def test_memory_does_not_grow(rig):
    def run(n):
        for _ in range(n):
            rig.cycle(*whole())
            rig.wire.sent.clear()

    run(200)
    gc.collect()
    before = sys.getallocatedblocks()
    run(2000)
    gc.collect()
    assert abs(sys.getallocatedblocks() - before) < 200


@pytest.mark.parametrize("noticed", ["in sending", "in an error frame"])
def test_after_an_error_the_few_tries_go_to_letting_go_and_not_to_questions(rig, noticed):
    rig.cycle(*positions(), FORCE, MOMENT)
    if noticed == "in sending":
        rig.wire.refuse = True
    else:
        rig.wire.errors.append(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
    assert not rig.arm.request()
    rig.wire.refuse, rig.wire.sent = False, []
    orders = rig.arm.torque_frame((0.0, 0.0, 0.0, 0.0)), *rig.arm.idle_frames()
    assert all(rig.bus.send(frame) for frame in orders)
    assert not rig.arm.request()
    assert rig.wire.sent == list(orders)
