"""A motor that is pushed and stands still: both sides of the bound, against numpy."""

import numpy as np
import pytest

from deploy.safety.unmoved import unmoved
from jaxmpc.law.transmission import JOINT_TO_MOTOR

T = np.array(JOINT_TO_MOTOR)
B = np.abs(np.linalg.inv(T))
BOUND = 3.0 * np.array([2.0, 2.25, 1.1, 0.66]) @ B
"""Three times the usual friction of each motor [N m]."""
LEVER = np.array([0.6, 0.6, 0.3, 0.5]) @ B
"""Torque of a motor for a newton at the tip, at most [N m]."""
STILL = (11,) * 4


def joints(motor, torque):
    """Joint torques of a motor's torque alone [N m]."""
    return tuple((T.T @ (torque * np.eye(4)[motor])).tolist())


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("push", [0.0, 8.0])
def test_it_is_found_beyond_friction_and_what_the_tissue_may_do(motor, sign, push):
    bound = BOUND[motor] + push * LEVER[motor]
    assert unmoved(STILL, joints(motor, sign * 1.001 * bound), push, 0, 1e-3) == motor
    assert unmoved(STILL, joints(motor, sign * 0.999 * bound), push, 0, 1e-3) == -1


@pytest.mark.parametrize("motor", range(4))
def test_one_that_moved_a_moment_ago_is_not(motor):
    pushed = joints(motor, 2.0 * BOUND[motor])
    assert unmoved([10 if i == motor else 500 for i in range(4)], pushed, 0.0, 500, 1e-3) == -1
    assert unmoved([11 if i == motor else 0 for i in range(4)], pushed, 0.0, 0, 1e-3) == motor


@pytest.mark.parametrize(("motor", "wait"), [(0, 300), (1, 100), (2, 100), (3, 300)])
def test_without_a_force_it_must_stand_still_for_long_on_the_way_out(motor, wait):
    pushed = joints(motor, 1.001 * BOUND[motor])
    assert unmoved((wait,) * 4, pushed, None, wait, 1e-3) == motor
    assert unmoved((wait - 1,) * 4, pushed, None, 1000, 1e-3) == -1
    assert unmoved((1000,) * 4, pushed, None, wait - 1, 1e-3) == -1  # it stood before the tip withdrew
    assert unmoved((wait // 4,) * 4, pushed, None, wait // 4, 4e-3) == motor


def test_what_is_not_a_number_is_found():
    assert unmoved(STILL, (0.0, 0.0, 0.0, float("nan")), 0.0, 0, 1e-3) == 3
    assert unmoved(STILL, joints(2, 2.0 * BOUND[2]), float("nan"), 0, 1e-3) == 0
