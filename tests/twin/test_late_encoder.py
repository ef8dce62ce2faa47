"""An encoder that tells late has the servo swing its joint: it goes on softer, and the tip still leaves the tissue."""

from dataclasses import replace

import pytest

from deploy.safety.reasons import Reason
from tests.twin.flying import fly

pytestmark = pytest.mark.oracle
HIGH = 0.075
"""Height of the tip 30 mm above where it presses [m]."""


@pytest.mark.parametrize("joint", ["J2", "J3", "J4"])
def test_the_tip_leaves_the_tissue_slower_than_the_limit(plain, joint):
    """Unseen, 40 ms brought J3 to 2.3 and J4 to 3.0 rad/s: the safety module let the arm go on its way."""
    flight = fly(plain, f"{joint}:delayed=40@1.6", reference="0,0,-2@5", seconds=1.0)
    assert flight.reason is Reason.JOINT_VELOCITY
    assert flight.fastest.max() < 1.5
    assert not flight.ended.safety_state.let_go
    assert flight.twin.truth().tip[2] > HIGH


def test_the_servo_swings_no_more_while_the_arm_is_held(cautious):
    """The fourth joint came to 2.7 rad/s, and went on until the arm was let go."""
    flight = fly(cautious, "J4:delayed=20@1.481", stiffness=375.0, reference="0,0,-2@5", seconds=1.6, seed=14)
    assert (flight.reason, flight.ended.safety_state.detail) == (Reason.JOINT_VELOCITY, "J4 swings")
    assert flight.fastest.max() < 1.2
    assert abs(flight.signals()["qd"][-100:, 3]).max() < 0.1


def test_a_healthy_encoder_at_the_fastest_heart_changes_nothing(plain):
    flight = fly(plain, reference="0,0,-2@5", seconds=1.0, rhythm="fibrillation")
    assert flight.reason is Reason.FINISHED
    assert flight.twin.truth().tip[2] > HIGH


def test_a_limit_below_what_the_way_out_needs_ends_the_run_and_does_not_weaken_the_servo(plain):
    """Softened twice, a healthy arm was held 25 mm lower, and touched the tissue for 0.4 s instead of 0.2."""
    limits = replace(plain.arm.limits, joint_velocity=(0.05,) * 4)
    flight = fly(plain, reference="0,0,-2@5", seconds=1.0, limits=limits, mass_scale=1.1)
    assert flight.reason is Reason.JOINT_VELOCITY
    assert flight.twin.truth().tip[2] > HIGH


def test_lost_positions_of_another_joint_blind_it_not(plain):
    """J4 came to 2.8 to 5.3 rad/s: each stretch of old positions took away what had been seen."""
    lost = [f"J1:lost=3@{2.1 + 0.09 * i:.2f}" for i in range(12)]
    flight = fly(plain, "J4:delayed=40@1.6", *lost, reference="0,0,-5@4", seconds=1.2)
    assert flight.reason is Reason.POSITION_OLD
    assert flight.fastest.max() < 2.0  # beyond, the safety module lets the arm go
    assert not flight.ended.safety_state.let_go
