"""The module comes as an argument, so that the mutation test can hand in a wrong one."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.controller import least_rate as right
from deploy.controller.file import from_bytes, to_bytes
from deploy.controller.limits import Limits
from deploy.safety.clamp import bounds
from deploy.safety.puck_caps import within_caps
from jaxmpc.files.errors import InputError
from tests.deploy.made import arm_artifact

T_S = 1e-3
IPNM = (2472, 2562, 2700, 2755)
LIMITS = Limits.default((0.5, 0.0, 0.05))
CHANGE = (42 / 2472, 28.25 / 2562, 16.8155 * (1 / 2562 + 1 / 2700), 18 / 2755)


@pytest.fixture(scope="module")
def least_rate():
    return right


def test_what_known_arms_have_is_within(least_rate):
    low, high = least_rate.IPNM_RANGE
    assert (low, high) == (2000, 3500)
    assert min(IPNM) > low
    assert max(IPNM) < high
    assert least_rate.CAPPED == 0.9
    assert least_rate.SLACK == 1e-9


def test_what_rounding_changes(least_rate):
    assert least_rate.lost(IPNM) == pytest.approx(CHANGE, rel=1e-12)
    other = (2472, 2700, 2562, 2755)  # the coarser of motors 2 and 3 counts for joint 2
    assert least_rate.lost(other) == pytest.approx(CHANGE, rel=1e-12)


def test_too_slow_a_rate_is_refused(least_rate):
    def refused(limits, *share):
        with pytest.raises(InputError) as error:
            least_rate.check_rates(limits, T_S, IPNM, *share)
        return str(error.value)

    coarse = replace(LIMITS, joint_torque=(75.6, 101.7, 1.0, 28.8), torque_rate=(10000.0, 200.0, 10000.0, 10000.0))
    assert "limits.torque_rate[1] = 200.0: must be at least 1.3" in refused(coarse)
    # least = (lost + shrink · most) / T_s, here with shrink from J3: its change over its limit
    least = (CHANGE[1] + CHANGE[2] / 1.0 * 101.7 + 4e-9) / T_S
    least_rate.check_rates(replace(coarse, torque_rate=(10000.0, least * 1.0001, 10000.0, 10000.0)), T_S, IPNM)
    refused(replace(coarse, torque_rate=(10000.0, least * 0.9999, 10000.0, 10000.0)))
    # … and from motor 2
    weak = replace(LIMITS, motor_torque=(1.8, 0.1, 1.8, 1.6), torque_rate=(10000.0, 200.0, 10000.0, 10000.0))
    least = (CHANGE[1] + 1 / 2562 / 0.1 * 20.0) / T_S
    assert 80 < least < 200
    least = (CHANGE[1] + 1 / 2562 / 0.1 * 60.0 + 4e-9) / T_S
    least_rate.check_rates(
        replace(weak, joint_torque=(25, 60, 15, 15), torque_rate=(1e4, least * 1.0001, 1e4, 1e4)), T_S, IPNM
    )
    refused(replace(weak, joint_torque=(25, 60, 15, 15), torque_rate=(1e4, least * 0.9999, 1e4, 1e4)))
    held = replace(weak, joint_torque=(25, 20, 15, 15))
    least_rate.check_rates(held, T_S, IPNM)
    # … of which its puck may give less
    share = 1 / 2562 / 0.1 * 20.0 / (200.0 * T_S - CHANGE[1])
    least_rate.check_rates(held, T_S, IPNM, share * 1.001)
    refused(held, share * 0.999)


def test_what_is_frozen_is_not_too_slow_for_any_arm():
    """Or a run would refuse it once it has started the arm and tared the sensor."""
    made = arm_artifact()
    motors = (0.1, *made.arm.limits.motor_torque[1:])
    slow = replace(made.arm.limits, motor_torque=motors, joint_torque=(70.0, 50.0, 30.0, 14.0))
    bounds(replace(slow, torque_rate=(600.0, 10000.0, 3000.0, 2000.0)), T_S, (2000,) * 4)
    for rate in (200.0, 350.0):  # the second would do for a puck of 2700 units per N m
        limits = replace(slow, torque_rate=(rate, 10000.0, 3000.0, 2000.0))
        with pytest.raises(InputError, match=r"limits\.torque_rate\[0\].* at least 410 N m/s"):
            replace(made, arm=replace(made.arm, limits=limits))
    fine = replace(slow, torque_rate=(420.0, 10000.0, 3000.0, 2000.0))
    artifact = replace(made, arm=replace(made.arm, limits=fine))
    assert from_bytes(to_bytes(artifact)).arm.limits == fine
    assert np.isfinite(bounds(fine, T_S, (2000,) * 4).torque).all()


@pytest.mark.parametrize(
    ("joints", "motors"),
    [
        ((4.7, 101.7, 60.0, 28.0), (1.8, 1.8, 1.8, 1.6)),
        ((75.0, 101.7, 60.0, 2.0), (1.8, 1.8, 1.8, 1.6)),
        ((75.0, 3.5, 2.0, 28.0), (1.8, 1.8, 1.8, 1.6)),
        ((70.0, 50.0, 30.0, 14.0), (0.2, 1.8, 1.8, 1.6)),
        ((70.0, 50.0, 30.0, 14.0), (1.8, 0.2, 0.5, 1.6)),
    ],
)
def test_what_is_frozen_has_bounds_on_the_weakest_arm_that_a_run_takes(joints, motors):
    """With the coarsest units, and with the lowest caps of the pucks that are not refused."""
    coarse = (right.IPNM_RANGE[0],) * 4
    slowest = replace(LIMITS, joint_torque=joints, motor_torque=motors, torque_rate=(12000.0,) * 4)
    for i in range(4):
        low, high = 200.0, 12000.0
        while high - low > 1e-6:
            rate = 0.5 * (low + high)
            tried = replace(
                slowest, torque_rate=tuple(rate if j == i else r for j, r in enumerate(slowest.torque_rate))
            )
            try:
                right.check_rates(tried, T_S, coarse, right.CAPPED)
                slowest, high = tried, rate
            except InputError:
                low = rate
    shared = joints[1] / 56.5 + joints[2] / 33.631
    needed = np.minimum(motors, (joints[0] / 42.0, shared, shared, joints[3] / 18.0))
    assert min(slowest.torque_rate) < 3000.0
    bounds(within_caps(slowest, (right.CAPPED + 1e-9) * needed)[0], T_S, coarse)
