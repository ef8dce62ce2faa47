"""A joint that the servo swings is found, and one that the servo brakes is not."""

import pytest

from deploy.safety.swing import BRAKED, CONFIRMED, FAST, SwingState, swing_step

LIMITS = (2.0, 1.9, 1.8, 0.5)
FASTER = 1.001


def run(speeds, T_s=1e-3, moving=lambda i: True, fresh=lambda i: True, bounds=FAST, held=False):
    """In which samples a swing is found."""
    state, found = SwingState(), []
    for i, qd in enumerate(speeds):
        state, swings = swing_step(state, moving(i), fresh(i), qd, bounds, T_s, held)
        if swings:
            found.append(i)
    return found


def turning(joint, speed, samples):
    return [tuple(speed * (i == joint) for i in range(4))] * samples


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("bounds", [FAST, LIMITS])
@pytest.mark.parametrize("joint", range(4))
def test_a_fast_joint_is_found_whichever_way_it_turns_by_the_bound_of_its_own(joint, bounds, sign):
    still = turning(0, 0.0, 200)
    assert run(still + turning(joint, sign * bounds[joint], 300), bounds=bounds) == []
    assert run(still + turning(joint, sign * FASTER * bounds[joint], 3), bounds=bounds) == [202]


def test_it_must_last():
    fast, slow = turning(2, -0.9, 2), turning(2, 0.3, 1)
    assert run(turning(0, 0.0, 200) + (fast + slow) * 20) == []


def test_what_was_fast_before_has_time_to_be_braked_and_so_has_a_softer_servo():
    assert run(turning(1, 1.5, 300)) == [102, 205]
    assert run(turning(1, 1.5, 300), moving=lambda i: i != 150) == [102, 253]


@pytest.mark.parametrize(("T_s", "samples"), [(1e-3, 3), (2e-3, 2), (8e-3, 2)])
def test_times_are_those_of_the_clock_at_every_rate(T_s, samples):
    assert run(turning(1, 1.5, 300), T_s)[0] == round(BRAKED / T_s) + samples - 1
    assert samples == max(round(CONFIRMED / T_s), 2)


def test_nobody_swings_what_is_not_driven_by_the_servo():
    assert run(turning(1, 1.5, 500), moving=lambda i: False) == []


def test_positions_that_are_late_now_and_then_blind_it_not():
    """Each took the memory away: with bursts of lost replies a late encoder came to 5.3 rad/s."""
    assert run(turning(1, 1.5, 300), fresh=lambda i: i % 50 < 47) == [108, 217]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_whoever_pushes_an_arm_that_is_held_turns_a_joint_one_way(sign):
    """A softer servo gave way to 40 N by hand: a joint came to 2.9 rad/s, and the safety module let the arm go."""
    still, there, back = turning(0, 0.0, 200), turning(3, sign * 1.2, 100), turning(3, -sign * 1.2, 100)
    pushed = still + there + still + turning(2, sign * 1.2, 100) + still
    assert run(pushed, held=True) == []
    assert run(still + there + still[:1] + back, held=True) == [303]
    assert run(still + there + turning(2, -sign * 1.2, 100), held=True) == []
    assert run(still + there + turning(3, -sign * 0.6, 100), held=True) == []
