"""An encoder that sticks in contact is found as the tip withdraws, before its joint swings."""

import numpy as np
import pytest

from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from tests.twin.flying import fly

pytestmark = pytest.mark.oracle


@pytest.mark.parametrize(("joint", "named"), [("J2", "motor 2"), ("J3", "motor 3"), ("J4", "J4")])
def test_it_is_found_on_the_way_out(plain, joint, named):
    """Unseen, J2 and J3 came to 1.4 and 1.9 rad/s, J4 to 2.9."""
    flight = fly(plain, f"{joint}:stuck@2.5", seconds=3.0)
    assert flight.reason is Reason.ENCODER_STUCK
    assert named in flight.ended.safety_state.detail
    assert flight.ended.safety_state.let_go
    retracting = sum(now.state is OperatingState.RETRACT for now in flight.safety_states)
    assert 0 < retracting < 450
    assert flight.fastest.max() < 0.8


@pytest.mark.parametrize(("joint", "cycles", "fastest"), [("J3", 150, 1.0), ("J4", 620, 1.7)])
def test_a_tissue_that_presses_and_pulls_hard_hides_it_no_longer(plain, joint, cycles, fastest):
    """What it may do was taken for more than it does: J3 and J4 came to 1.4 and 2.3 rad/s, with `force` the reason."""
    flight = fly(plain, f"{joint}:stuck@1.76", stiffness=375.0, reference="0,0,-10@10", seconds=1.5)
    assert flight.reason is Reason.ENCODER_STUCK
    assert sum(now.state is OperatingState.RETRACT for now in flight.safety_states) < cycles
    assert flight.fastest.max() < fastest


def test_a_joint_that_need_not_move_may_stick(plain):
    """The first one turns about the way out."""
    flight = fly(plain, "J1:stuck@2.5", seconds=3.0)
    assert flight.reason is Reason.FINISHED
    assert flight.fastest.max() < 0.5


def test_healthy_joints_of_twice_the_friction_are_not_found(plain):
    flight = fly(plain, seconds=3.0, coulomb=tuple((2.0 * np.array([2.025, 2.25, 1.125, 0.66])).tolist()))
    assert flight.reason is Reason.FINISHED
