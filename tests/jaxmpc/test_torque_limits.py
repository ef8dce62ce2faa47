"""Limits of the joint torques in the simulation against the robot's clamp, and their tangent."""

import math

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given

from deploy.safety import clamp
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.torque_limits import TorqueLimits, limit
from jaxmpc.law.transmission import MOTOR_TORQUE_LIMIT, N1, N4
from jaxmpc.xla import ops

WIDE = TorqueLimits((math.inf,) * 4, (math.inf,) * 4, MOTOR_TORQUE_LIMIT)
ROBOT = TorqueLimits((50.0, 50.0, 50.0, 20.0), (10.0, 10.0, 10.0, 2.0), MOTOR_TORQUE_LIMIT)
WEAK = ROBOT._replace(torque=(5.0, 6.0, 3.0, 2.0), motor=(1.8, 0.1, 0.2, 1.6))
"""That the torques of the last sample are above, as where an arm that is held by more gets these limits."""
wide, near = st.tuples(*[st.floats(-150.0, 150.0)] * 4), st.tuples(*[st.floats(-20.0, 20.0)] * 4)


def clamped(limits, wanted, last):
    """What the robot's clamp makes of it, its bounds as they are without rounding to units."""
    (t1, t2, t3, t4), motor = limits.torque, limits.motor
    most = (min(t1, N1 * motor[0]), t2, t3, min(t4, N4 * motor[3]))
    return clamp.clamp(wanted, last, clamp.Bounds(most, limits.step, motor[1], motor[2]))


@given(wanted=wide, last=near)
def test_it_is_the_robots_clamp(wanted, last):
    for limits in (ROBOT, ROBOT._replace(step=(1e3,) * 4), ROBOT._replace(motor=(1.8, 0.3, 0.2, 1.6)), WEAK):
        expected, acted = clamped(limits, wanted, last)
        found, flag = limit(limits, wanted, last, FLOATS)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        assert flag == (found != wanted)
        assert acted.acted or found == wanted


@given(wanted=near, last=near)
def test_where_nothing_acts_the_wanted_torque_passes_bit_by_bit(wanted, last):
    assert limit(WIDE, wanted, last, FLOATS) == (wanted, 0.0)


def test_two_joints_share_two_motors():
    """J2 alone gets 101.7 N m, J3 alone 60.5 N m, as the reference computes; not both at once."""
    for joint, most in ((0, 75.6), (1, 101.7), (2, 60.5), (3, 28.8)):
        asked = tuple(1e3 if i == joint else 0.0 for i in range(4))
        held, acted = limit(WIDE, asked, (0.0,) * 4, FLOATS)
        np.testing.assert_allclose(np.abs(held), [most if i == joint else 0.0 for i in range(4)], atol=0.06)
        assert acted == 1.0
    both, _ = limit(WIDE, (0.0, 101.7, 60.5, 0.0), (0.0,) * 4, FLOATS)
    assert abs(both[1]) / (2 * 28.25) + abs(both[2]) / (2 * 16.8155) <= 1.8 + 1e-12


def test_a_tuner_sees_the_loop_through_its_saturation():
    """In either mode the slope is that of the wanted torques, that of the last torques is 0."""
    wanted, last = (100.0, -4.0, 5.0, 0.3), (0.0, 1.0, 2.0, -3.0)
    for derivative in (jax.jacfwd, jax.jacrev):
        slopes = derivative(lambda *x: jnp.stack(limit(ROBOT, *x, ops)[0]), (0, 1))(wanted, last)
        np.testing.assert_array_equal(np.stack(slopes[0], 1), np.eye(4))
        np.testing.assert_array_equal(np.stack(slopes[1], 1), np.zeros((4, 4)))
