"""Of which state of the arm no torque passes. The module comes as an argument, so that the mutation test can hand in a
wrong one."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.puck.frame import Frame
from deploy.safety import checker as right
from deploy.safety.reasons import Reason
from tests.deploy.checking import IPNM, LIMITS, MOTION, PIDX, POSTURE, REST, WIDE, asked, make


@pytest.fixture(scope="module")
def checker():
    return right


def test_age_of_positions(checker):
    expected = {
        "control": {
            0: None,
            1: None,
            2: None,
            3: Reason.POSITION_OLD,
            20: Reason.POSITION_OLD,
            21: Reason.POSITION_LOST,
        },
        "safe": {0: None, 2: None, 3: None, 20: None, 21: Reason.POSITION_LOST, 10**9: Reason.POSITION_LOST},
    }
    for how, ages in expected.items():
        for age, reason in {-1: Reason.POSITION_LOST, **ages}.items():
            assert asked(make(checker), checker, how=how, age=age) is reason


def test_an_arm_is_held_for_twenty_milliseconds_whatever_the_rate(checker):
    for T_s, held in ((1e-4, 200), (1e-3, 20), (3e-3, 7), (0.0115, 2), (0.1, 2)):
        made = checker.Checker(LIMITS, T_s, IPNM, PIDX, 0.36)
        assert asked(made, checker, how="safe", age=held) is None
        assert asked(made, checker, how="safe", age=held + 1) is Reason.POSITION_LOST


def test_angles_and_velocities_that_are_not_finite(checker):
    for bad, joint, how in itertools.product((math.nan, math.inf, -math.inf), range(4), ("control", "safe")):
        values = tuple(bad if i == joint else each for i, each in enumerate(POSTURE))
        assert asked(make(checker), checker, how=how, q=values) is Reason.NOT_FINITE
        values = tuple(bad if i == joint else 0.0 for i in range(4))
        assert asked(make(checker), checker, how=how, qd=values) is Reason.NOT_FINITE


def test_joint_ranges(checker):
    # poses that keep all else within its limits
    for joint, q in enumerate([(1.0, 0.7, 0.0, 2.2), (0.0, 1.2, 0.0, 2.2), (0.0, 0.7, 0.8, 2.2), (0.0, 0.7, 0.0, 1.5)]):
        for low, high in ((q[joint], 2.0), (-0.9, q[joint])):
            ranges = [*WIDE.joint_range]
            ranges[joint] = (low, high)
            made = make(checker, replace(WIDE, joint_range=tuple(ranges)))
            assert asked(made, checker, q=q) is None
            away = 9.0 if q[joint] == high else -9.0
            beyond = tuple(float(np.nextafter(each, away)) if i == joint else each for i, each in enumerate(q))
            assert asked(made, checker, q=beyond) is Reason.JOINT_RANGE
            assert asked(made, checker, q=beyond, how="safe") is None


def test_joint_velocities(checker):
    for joint, sign in itertools.product(range(4), (-1.0, 1.0)):
        made = make(checker, replace(WIDE, joint_velocity=(0.5,) * 4))
        qd = tuple(sign * 0.5 * (i == joint) for i in range(4))
        assert asked(made, checker, qd=qd) is None
        beyond = tuple(float(np.nextafter(each, 9.0 * sign)) if each else 0.0 for each in qd)
        assert asked(made, checker, qd=beyond) is Reason.JOINT_VELOCITY
        assert asked(made, checker, qd=beyond, how="safe") is None


def test_workspace(checker):
    tip = MOTION(POSTURE, REST).tip
    for axis in range(3):
        for low, high in ((tip[axis], 1.0), (-1.0, tip[axis])):
            box = [(-1.0, 1.0)] * 3
            box[axis] = (low, high)
            assert asked(make(checker, replace(WIDE, workspace=tuple(box))), checker) is None
            box[axis] = (float(np.nextafter(low, 9)), 1.0) if high == 1.0 else (-1.0, float(np.nextafter(high, -9)))
            made = make(checker, replace(WIDE, workspace=tuple(box)))
            assert asked(made, checker) is Reason.WORKSPACE
            assert asked(made, checker, how="safe") is None


def test_speed_of_tip_and_elbow(checker):
    for qd, reason in (
        ((0.2, 0.3, 0.1, 0.9), Reason.TIP_VELOCITY),
        ((1.2, 0.2, -1.4, 0.6), Reason.ELBOW_VELOCITY),
    ):
        _, tip, elbow, _ = MOTION(POSTURE, qd)
        assert (tip > elbow) == (reason is Reason.TIP_VELOCITY)
        assert asked(make(checker, replace(WIDE, tip_velocity=max(tip, elbow))), checker, qd=qd) is None
        made = make(checker, replace(WIDE, tip_velocity=float(np.nextafter(max(tip, elbow), 0.0))))
        assert asked(made, checker, qd=qd) is reason
        assert asked(made, checker, qd=qd, how="safe") is None


def test_nearness_to_a_singularity(checker):
    q = (0.1, 0.9, 0.2, 0.5)
    value = MOTION(q, REST).least_singular_value
    assert asked(make(checker, replace(WIDE, least_singular_value=value)), checker, q=q) is None
    made = make(checker, replace(WIDE, least_singular_value=float(np.nextafter(value, 1.0))))
    assert asked(made, checker, q=q) is Reason.SINGULARITY
    assert asked(made, checker, q=q, how="safe") is None


def test_force(checker):
    made = make(checker, replace(LIMITS, force=13.0))
    over = float(np.nextafter(13.0, 99.0))
    for good in (None, (3.0, -4.0, 12.0), (13.0, 0, 0), (0, -13.0, 0), (0, 0, 13.0)):
        assert asked(made, checker, force=good) is None
    for bad in ((3.0, 4.0, 12.001), (over, 0, 0), (0, -over, 0), (0, 0, over), (9.0, 9.0, 9.0)):
        assert asked(made, checker, force=bad) is Reason.FORCE
        assert asked(made, checker, force=bad, how="safe") is None
    for bad, axis in itertools.product((math.nan, math.inf, -math.inf, 1e200), range(3)):
        force = tuple(bad if i == axis else 0.0 for i in range(3))
        assert asked(made, checker, force=force) is Reason.FORCE_NOT_FINITE
        assert asked(made, checker, force=force, how="safe") is None


def test_numbers_never_make_it_raise(checker):
    draw = np.random.default_rng(9)
    odd = np.array([0.0, -0.0, 1.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 2.6, math.pi])
    made = make(checker)
    for _ in range(100):
        q, qd, force = (tuple(draw.choice(odd, n).tolist()) for n in (4, 4, 3))
        frame = Frame(0x401, bytes([0xAA]) + draw.bytes(7))
        for how in ("control", "safe"):
            found = made.check(frame, True, checker.Strictness(how), q, qd, force, 0)
            assert found is None or isinstance(found, Reason)
