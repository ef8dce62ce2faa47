"""The module comes as an argument, so that the mutation test can hand in a wrong one."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.controller.limits import Limits
from deploy.safety import clamp as right
from jaxmpc.files.errors import InputError

# wam.md §2.3
JOINT_TO_MOTOR = np.array([[-42, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18]])
T_S = 1e-3
IPNM = (2472, 2562, 2700, 2755)
LIMITS = Limits.default((0.5, 0.0, 0.05))
TIGHT = replace(LIMITS, motor_torque=(0.3, 0.2, 0.4, 0.5), torque_rate=(1000.0, 600.0, 400.0, 300.0))
HELD = (0.0, 0.0, 0.0, 0.0)
CHANGE = (42 / 2472, 28.25 / 2562, 16.8155 * (1 / 2562 + 1 / 2700), 18 / 2755)


@pytest.fixture(scope="module")
def clamp():
    return right


def sent(torque, ipnm=IPNM):
    """What the pucks make of joint torques, in units and in torque: libbarrett's rounding towards −∞."""
    units = np.floor(np.linalg.solve(JOINT_TO_MOTOR.T, torque) * ipnm)
    return units, JOINT_TO_MOTOR.T @ (units / ipnm)


def excess(torque, last, limits, T_s=T_S):
    """By how much a torque breaks any limit; at most 0 is allowed."""
    motors = np.abs(np.linalg.solve(JOINT_TO_MOTOR.T, torque)) - limits.motor_torque
    return max(
        np.max(np.abs(torque) - limits.joint_torque),
        np.max(np.abs(np.subtract(torque, last)) - np.multiply(limits.torque_rate, T_s)),
        np.max(motors),
    )


def make(clamp, limits=LIMITS):
    within = clamp.bounds(limits, T_S, IPNM)
    return lambda wanted, last=HELD: clamp.clamp(wanted, last, within)


def close(torque, expected):
    # the slack of 1e-9 N m at a motor is 56.5e-9 N m at joint 2
    return torque == pytest.approx(expected, abs=6e-8)


def test_bounds_are_the_limits_less_the_rounding_and_a_slack(clamp):
    for ipnm, of_pair in ((IPNM, 2562), ((2472, 2700, 2562, 2755), 2562)):
        within = clamp.bounds(LIMITS, T_S, ipnm)
        change = [42 / 2472, 28.25 / of_pair, 16.8155 * (1 / 2562 + 1 / 2700), 18 / 2755]
        exact = {"abs": 1e-12, "rel": 0.0}
        assert within.torque == pytest.approx(np.subtract(LIMITS.joint_torque, change) - 1e-9, **exact)
        assert within.step == pytest.approx(np.multiply(LIMITS.torque_rate, T_S) - change - 1e-9, **exact)
        assert within.motor2 == pytest.approx(1.8 - 1 / ipnm[1] - 1e-9, **exact)
        assert within.motor3 == pytest.approx(1.8 - 1 / ipnm[2] - 1e-9, **exact)


def test_within_the_limits_nothing_changes(clamp):
    wanted = (1.5, -7.0, 0.9, -1.2)
    torque, acted = make(clamp)(wanted)
    assert torque is wanted
    assert acted == clamp.NOTHING == (False, False, False, False)
    assert not acted.acted


def test_rate_and_magnitude_reach_up_to_the_rounding(clamp):
    run = make(clamp)
    steps = np.multiply(LIMITS.torque_rate, T_S) - CHANGE
    most = np.subtract(LIMITS.joint_torque, CHANGE)
    for sign in (-1.0, 1.0):
        for joint in range(4):
            for beyond in (1e-7, 1.0, 1e9):
                wanted = tuple(sign * (steps[joint] + beyond) * (i == joint) for i in range(4))
                torque, acted = run(wanted)
                assert close(torque, sign * steps * (np.arange(4) == joint))
                assert acted == (False, beyond == 1e9, True, False)
                assert acted.acted
                last = tuple(sign * (most[joint] - 0.5) * (i == joint) for i in range(4))
                torque, acted = run(tuple(sign * (most[joint] + beyond) * (i == joint) for i in range(4)), last)
                assert close(torque, sign * most * (np.arange(4) == joint))
                assert acted == (False, True, False, False)
                inside = tuple(sign * (most[joint] - 2e-9) * (i == joint) for i in range(4))
                assert run(inside, last) == (inside, clamp.NOTHING)


def test_rate_holds_from_what_was_sent_last(clamp):
    run = make(clamp)
    last = (4.0, -8.0, 3.0, -2.0)
    steps = np.multiply(LIMITS.torque_rate, T_S) - CHANGE
    assert close(run((-9.0, 9.0, -9.0, 9.0), last)[0], last + steps * [-1, 1, -1, 1])
    assert close(run((20.0, -19.0, 9.0, -9.0), last)[0], last + steps * [1, -1, 1, -1])
    assert run(last, last) == (last, clamp.NOTHING)


def test_motors_1_and_4_limit_their_joints(clamp):
    run = make(clamp, TIGHT)
    torque, acted = run((99.0, 0.0, 0.0, -99.0), (12.4, 0.0, 0.0, -8.9))
    assert close(torque, (42 * (0.3 - 1 / 2472), 0.0, 0.0, -18 * (0.5 - 1 / 2755)))
    assert acted == (False, True, False, False)
    small = replace(LIMITS, joint_torque=(9.0, 20.0, 15.0, 7.0))
    torque, _ = make(clamp, small)((99.0, 0.0, 0.0, -99.0), (8.9, 0.0, 0.0, -6.9))
    assert close(torque, (9.0 - CHANGE[0], 0.0, 0.0, -7.0 + CHANGE[3]))


def test_shared_motors_keep_the_direction(clamp):
    free = replace(TIGHT, torque_rate=(10000.0,) * 4)
    most2, most3 = 0.2 - 1 / 2562, 0.4 - 1 / 2700
    cases = [(-9.0, 3.0), (8.0, -7.0), (-9.9, 1.5), (-1.0, -9.9), (11.6, 9.0), (-13.0, -9.4)]
    for wanted in [(0.0, *pair, 0.0) for pair in cases]:
        last = tuple(0.3 * each for each in wanted)
        torque, acted = make(clamp, free)(wanted, last)
        motors = np.abs(np.linalg.solve(JOINT_TO_MOTOR.T, wanted))
        expected = np.multiply(wanted, min(1.0, most2 / motors[1], most3 / motors[2]))
        assert close(torque, expected)
        assert acted == (False, False, False, True)
        assert acted.acted


def test_shared_motors_where_the_rate_forbids_the_direction(clamp):
    run = make(clamp, TIGHT)
    # motor 2 at its limit by J2 alone; J3 is wanted as well, and the scaled pair would drop J2 by more than 0.6 N m
    last = tuple(sent((0.0, 11.2, 0.0, 0.0))[1])
    torque, acted = run((0.0, 11.2, -60.0, 0.0), last)
    assert acted == (False, True, True, True)
    assert excess(sent(torque)[1], last, TIGHT) <= 0.0
    # it moves, as far as one of the two rates allows, towards the scaled pair
    steps = np.multiply(TIGHT.torque_rate, T_S) - CHANGE
    moved = np.abs(np.subtract(torque, last))[1:3]
    assert np.max(moved / steps[1:3]) == pytest.approx(1.0, abs=0.05)
    # and arrives: the scaled pair is the end of the way
    for _ in range(400):
        torque, _ = run((0.0, 11.2, -60.0, 0.0), last)
        assert excess(sent(torque)[1], last, TIGHT) <= 0.0
        last = tuple(sent(torque)[1])
    motors = np.linalg.solve(JOINT_TO_MOTOR.T, last)
    assert max(abs(motors[1]) / 0.2, abs(motors[2]) / 0.4) > 0.98
    assert abs(last[2]) > 1.0


def test_a_way_cut_short_begins_within_what_the_motors_can_bear(clamp):
    """Rounding has taken what was sent last up to a unit further; the way along that limit may not begin there."""
    within = clamp.bounds(TIGHT, T_S, IPNM)
    last = tuple(JOINT_TO_MOTOR.T @ [0.0, -0.2, 0.05, 0.0])
    torque, acted = clamp.clamp(tuple(JOINT_TO_MOTOR.T @ [0.0, -0.4, -0.8, 0.0]), last, within)
    assert acted.motors
    # cut short: motor 3 is not where it was wanted
    motors = np.linalg.solve(JOINT_TO_MOTOR.T, torque)
    assert abs(motors[2]) < 0.9 * within.motor3
    assert abs(motors[1]) <= within.motor2 * (1.0 + 1e-12)
    assert excess(sent(torque)[1], last, TIGHT) <= 0.0


def test_what_is_not_finite_becomes_zero_never_the_last(clamp):
    run = make(clamp)
    steps = np.multiply(LIMITS.torque_rate, T_S) - CHANGE
    for joint, bad in itertools.product(range(4), (math.nan, math.inf, -math.inf)):
        wanted = tuple(bad if i == joint else 3.0 for i in range(4))
        torque, acted = run(wanted, (0.5, 0.5, 0.5, 0.5))
        assert torque == (0.0, 0.0, 0.0, 0.0)
        assert acted == (True, False, False, False)
        assert acted.acted
        torque, acted = run(wanted, (9.0, 15.0, -9.0, -9.0))
        assert close(torque, np.add((9.0, 15.0, -9.0, -9.0), steps * [-1, -1, 1, 1]))
        assert acted == (True, False, True, False)


def random_case(draw, limits):
    """Something wanted from something that can have been sent, most of them at a limit."""
    scale = draw.choice([0.5, 1.0, 1.5, 30.0])
    last = np.multiply(draw.uniform(-1, 1, 4) * draw.choice([0.3, 1.0, 1.2]), limits.joint_torque)
    motors = np.abs(np.linalg.solve(JOINT_TO_MOTOR.T, last)) / limits.motor_torque
    joints = np.abs(last) / limits.joint_torque
    last = last / max(1.0, np.max(motors) * 1.0000001, np.max(joints) * 1.0000001)
    units = np.linalg.solve(JOINT_TO_MOTOR.T, last) * IPNM
    last = JOINT_TO_MOTOR.T @ (np.trunc(units) / IPNM)
    wanted = scale * draw.uniform(-1, 1, 4) * limits.joint_torque + draw.integers(0, 2) * last
    return tuple(wanted.tolist()), tuple(last.tolist())


def test_whatever_is_wanted_is_allowed_after_rounding(clamp):
    draw = np.random.default_rng(6)
    for limits in (LIMITS, TIGHT, replace(LIMITS, motor_torque=(1.8, 0.12, 0.9, 1.6), joint_torque=(25, 20, 2, 15))):
        within = clamp.bounds(limits, T_S, IPNM)
        for _ in range(150):
            wanted, last = random_case(draw, limits)
            # trunc takes last further inside or not at all but for the other joint of a pair
            if excess(np.array(last), last, limits) > 0.0:
                continue
            torque, acted = clamp.clamp(wanted, last, within)
            assert excess(sent(torque)[1], last, limits) <= 0.0
            assert acted.acted == (torque != wanted)


CORNERS = [
    # slowest rates that are allowed with them; J2 or J3 the slower one
    replace(LIMITS, motor_torque=(1.8, 0.12, 0.9, 1.6), joint_torque=(25, 5, 2, 15), torque_rate=(400, 200, 200, 400)),
    replace(LIMITS, motor_torque=(1.8, 0.9, 0.12, 1.6), joint_torque=(25, 5, 9, 15), torque_rate=(400, 200, 900, 400)),
    replace(LIMITS, motor_torque=(1.8, 0.15, 0.11, 1.6), joint_torque=(25, 9, 2, 15), torque_rate=(400, 900, 200, 400)),
]


def outermost(draw, limits):
    """Torques of motors 2 and 3, in whole units, as near to a limit as they can be sent."""
    motors = draw.uniform(-1, 1, 4) * draw.choice([0.3, 1.0, 3.0], 4)
    units = np.zeros(4)
    units[1:3] = motors[1:3] * np.multiply(limits.motor_torque, IPNM)[1:3]
    at = JOINT_TO_MOTOR.T @ (units / IPNM)
    over = [abs(at[1]) / limits.joint_torque[1], abs(at[2]) / limits.joint_torque[2]]
    over += list(np.abs(units[1:3]) / np.multiply(limits.motor_torque, IPNM)[1:3])
    units = np.round(units / max(*over, 1e-9))
    # rounding may have gone beyond a limit: the next units inside
    for _ in range(3):
        for step in itertools.product((0, -1, 1), repeat=2):
            near = np.add(units, (0, *step, 0))
            if excess(JOINT_TO_MOTOR.T @ (near / IPNM), HELD, replace(limits, torque_rate=(12000.0,) * 4)) <= 0.0:
                return tuple((JOINT_TO_MOTOR.T @ (near / IPNM)).tolist())
        units = np.trunc(units * 0.99)
    return HELD


def test_from_the_outermost_torques_there_is_a_way(clamp):
    draw = np.random.default_rng(13)
    for limits in CORNERS:
        within = clamp.bounds(limits, T_S, IPNM)
        for _ in range(250):
            last = outermost(draw, limits)
            wanted = (0.0, *(draw.choice([1.0, 1.0, 20.0], 2) * (last[1:3] + draw.normal(size=2))).tolist(), 0.0)
            torque, _ = clamp.clamp(wanted, last, within)
            assert excess(sent(torque)[1], last, limits) <= 0.0


def test_the_slower_of_two_joints_sets_the_pace(clamp):
    for limits, slow in ((CORNERS[1], 1), (CORNERS[2], 2)):
        within = clamp.bounds(limits, T_S, IPNM)
        draw = np.random.default_rng(14)
        paces, kept = [], 0
        for _ in range(300):
            last = outermost(draw, limits)
            wanted = (0.0, *(30.0 * draw.normal(size=2)).tolist(), 0.0)
            torque, acted = clamp.clamp(wanted, last, within)
            if not acted.motors:
                continue
            # on the way from what was sent (or just inside of it) to the pair that the motors can bear
            reached = np.abs(np.subtract(torque, last))[1:3] / within.step[1:3]
            assert np.max(reached) <= 1.0 + 1e-9
            paces.append(np.max(reached))
            kept += reached[slow - 1] > 0.999
        # most of them go as fast as they may
        assert len(paces) > 30
        assert kept > 5


def test_one_joint_alone_up_to_its_motors(clamp):
    within = clamp.bounds(TIGHT, T_S, IPNM)
    for joint, ratio in ((1, 28.25), (2, 16.8155)):
        for sign in (-1.0, 1.0):
            wanted = tuple(sign * 14.9 * (i == joint) for i in range(4))
            last = HELD
            for _ in range(60):
                torque, acted = clamp.clamp(wanted, last, within)
                assert excess(sent(torque)[1], last, TIGHT) <= 0.0
                last = tuple(sent(torque)[1].tolist())
            assert acted.motors
            # exactly alone, there is nothing to share, and no way to divide
            alone = tuple(sign * (2 * ratio * 0.2 - 0.02) * (i == joint) for i in range(4))
            torque, acted = clamp.clamp(wanted, alone, within)
            assert torque == pytest.approx(
                [sign * 2 * ratio * (0.2 - 1 / 2562) * (i == joint) for i in range(4)], abs=1e-6
            )
            assert acted.motors


def test_zero_and_gravity_are_always_reached(clamp):
    draw = np.random.default_rng(7)
    within = clamp.bounds(TIGHT, T_S, IPNM)
    for target in (HELD, (0.0, -10.2, 0.3, 1.4)):
        for _ in range(10):
            _, last = random_case(draw, TIGHT)
            for _ in range(200):
                torque, acted = clamp.clamp(target, last, within)
                last = tuple(sent(torque)[1])
                if not acted.acted:
                    break
            assert np.all(np.abs(np.subtract(last, target)) <= np.add(CHANGE, 1e-9))


def test_limits_that_close_the_way_have_no_bounds(clamp):
    slow = replace(LIMITS, joint_torque=(75.6, 101.7, 1.0, 28.8), torque_rate=(10000.0, 200.0, 10000.0, 10000.0))
    with pytest.raises(InputError, match=r"limits\.torque_rate\[1\]"):
        clamp.bounds(slow, T_S, IPNM)
