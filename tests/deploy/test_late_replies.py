"""What comes late, or not at all, is as old as it is and never taken for fresh."""

import random

import pytest

from deploy.puck import codec
from deploy.puck.frame import Frame
from tests.deploy.wire import FORCE, MOMENT, MS, START, Rig, moved, positions, whole

DOUBT = 20
"""Cycles at 1 kHz."""


@pytest.fixture
def rig():
    return Rig()


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


def test_one_reply_in_a_thousand_lost_is_counted_exactly(rig):
    draw = random.Random(0)
    lost = aged = 0
    for _ in range(3000):
        frames = [frame for frame in whole() if draw.random() >= 1e-3 or frame in (FORCE, MOMENT)]
        lost += 6 - len(frames)
        aged += sum(age > 0 for age in rig.cycle(*frames).position_age)
    assert aged == lost > 5
    assert (rig.arm.late, rig.arm.doubtful, rig.arm.jumps) == (0, 0, 0)
