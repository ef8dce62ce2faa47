"""Cycles of the arm on its bus: what is asked, taken, counted and sent."""

import gc
import sys

import can
import pytest

from deploy.bus.bus import MOST_AT_ONCE
from deploy.puck import codec, messages
from deploy.puck.codec import BROADCAST, GROUPS, decode
from deploy.puck.frame import Frame
from deploy.puck.messages import PropertyReply, Torques
from tests.deploy.pendants import encode_pendant
from tests.deploy.wire import FORCE, MOMENT, PENDANT, START, Rig, moved, positions, whole


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


def test_once_the_safety_module_speaks_to_all_it_is_asked_for_its_mode_at_once(rig):
    rig.cycle(Frame(BROADCAST, b"\x01\x02"), *whole())
    asked = []
    for _ in range(3):
        rig.wire.sent.clear()
        rig.cycle(*whole())
        asked.append(rig.wire.sent.count(codec.get(codec.SAFETY_MODULE, 8)))
    assert asked == [1, 0, 0]


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
