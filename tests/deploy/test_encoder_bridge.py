"""Motor counts over lost replies and over cycles that were missed."""

import pytest

from deploy.wam.encoder_bridge import EncoderBridge


def test_a_missing_count_goes_on_at_the_last_rate():
    bridge = EncoderBridge((0, 10, 20, 30))
    list(bridge.take((3, 8, 20, 30)))
    assert list(bridge.take((None, None, 21, None))) == [(6.0, 6.0, 21.0, 30.0)]
    assert list(bridge.take((None, 5, None, None))) == [(9.0, 5.0, 22.0, 30.0)]
    assert bridge.counts == (9.0, 5.0, 22.0, 30.0)


def test_before_it_has_moved_a_motor_stands():
    assert list(EncoderBridge((1, 2, 3, 4)).take((None,) * 4)) == [(1.0, 2.0, 3.0, 4.0)]


def test_over_missed_cycles_counts_go_in_even_steps_and_the_rate_is_that_of_a_cycle():
    bridge = EncoderBridge((0, 0, 0, 0))
    list(bridge.take((0, 2, 0, 0)))
    assert list(bridge.take((6, None, -3, 0), missed=2)) == [
        pytest.approx((2.0, 4.0, -1.0, 0.0)),
        pytest.approx((4.0, 6.0, -2.0, 0.0)),
        (6.0, 8.0, -3.0, 0.0),
    ]
    assert list(bridge.take((None,) * 4)) == [(8.0, 10.0, -4.0, 0.0)]


@pytest.mark.parametrize("lost", [1, 2])
def test_what_was_made_up_for_a_lost_reply_is_no_place_to_measure_a_rate_from(lost):
    """Taken for one it doubled the rate at every second or third reply, with the motor at rest."""
    bridge = EncoderBridge((0, 0, 0, 0))
    list(bridge.take((8, 0, 0, 0)))
    for _ in range(20):
        for _ in range(lost):
            list(bridge.take((None, 0, 0, 0)))
        assert abs(bridge.counts[0] - 8.0) <= 8.0 * lost
        list(bridge.take((8, 0, 0, 0)))
        assert bridge.counts[0] == 8.0
    list(bridge.take((None, 0, 0, 0)))
    assert bridge.counts[0] == 8.0


def test_a_motor_that_turns_evenly_is_met_where_it_is_whatever_is_lost():
    bridge = EncoderBridge((0, 0, 0, 0))
    for k in range(1, 60):
        list(bridge.take((3 * k if k < 3 or k % 5 == 0 else None, 0, 0, 0)))
        assert bridge.counts[0] == 3.0 * k
