"""A motor that is pushed and stands still: both sides of the bound, against numpy."""

import numpy as np
import pytest

from deploy.safety.unmoved import unmoved
from jaxmpc.law.transmission import JOINT_TO_MOTOR

T = np.array(JOINT_TO_MOTOR)
B = np.abs(np.linalg.inv(T))
BOUND = 3.0 * np.array([2.0, 2.25, 1.1, 0.66]) @ B
"""Three times the usual friction of each motor [N m]."""
NOTHING = (0.0, 0.0, 0.0, 0.0)
STILL = (11,) * 4


def joints(motor, torque):
    """Joint torques of a motor's torque alone [N m]."""
    return tuple((T.T @ (torque * np.eye(4)[motor])).tolist())


@pytest.mark.parametrize("motor", range(4))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("read", [0.0, 0.1, -0.2])
def test_it_is_found_beyond_friction_and_what_the_force_makes_of_it(motor, sign, read):
    """Of either sign, and that motor's share alone: another's explains nothing."""
    bound, tissue = BOUND[motor] + abs(read), joints(motor, read)
    assert unmoved(STILL, joints(motor, sign * 1.001 * bound), tissue, 0, 1e-3) == motor
    assert unmoved(STILL, joints(motor, sign * 0.999 * bound), tissue, 0, 1e-3) == -1
    other = joints((motor + 1) % 4, 9.0)
    assert unmoved(STILL, joints(motor, sign * 1.001 * BOUND[motor]), other, 0, 1e-3) == motor


@pytest.mark.parametrize("motor", range(4))
def test_one_that_moved_a_moment_ago_is_not(motor):
    pushed = joints(motor, 2.0 * BOUND[motor])
    assert unmoved([10 if i == motor else 500 for i in range(4)], pushed, NOTHING, 500, 1e-3) == -1
    assert unmoved([11 if i == motor else 0 for i in range(4)], pushed, NOTHING, 0, 1e-3) == motor


@pytest.mark.parametrize(("motor", "wait"), [(0, 300), (1, 100), (2, 100), (3, 300)])
def test_without_a_force_it_must_stand_still_for_long_on_the_way_out(motor, wait):
    pushed = joints(motor, 1.001 * BOUND[motor])
    assert unmoved((wait,) * 4, pushed, None, wait, 1e-3) == motor
    assert unmoved((wait - 1,) * 4, pushed, None, 1000, 1e-3) == -1
    assert unmoved((1000,) * 4, pushed, None, wait - 1, 1e-3) == -1  # it stood before the tip withdrew
    assert unmoved((wait // 4,) * 4, pushed, None, wait // 4, 4e-3) == motor


def test_what_is_not_a_number_is_found():
    assert unmoved(STILL, (0.0, 0.0, 0.0, float("nan")), NOTHING, 0, 1e-3) == 3
    assert unmoved(STILL, joints(2, 2.0 * BOUND[2]), (float("nan"),) * 4, 0, 1e-3) == 0
