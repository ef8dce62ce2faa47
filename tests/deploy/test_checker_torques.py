"""Which frames pass: torques up to each limit, service frames. The module comes as an argument, so that the mutation
test can hand in a wrong one."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.puck.frame import Frame
from deploy.safety import checker as right
from deploy.safety.reasons import Reason
from jaxmpc.files.errors import InputError
from tests.deploy.checking import IPNM, LIMITS, PIDX, POSTURE, PUSH, REST, T_S, WIDE, asked, frame_of, make

# wam.md §2.3
JOINT_TO_MOTOR = np.array([[-42, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18]])


@pytest.fixture(scope="module")
def checker():
    return right


def torque_of(units):
    return JOINT_TO_MOTOR.T @ np.divide(units, IPNM)


def test_vector_of_the_manual(checker):
    made = checker.Checker(LIMITS, T_S, (2700,) * 4, (1, 2, 3, 4), 0.36)
    frame = Frame(0x401, bytes.fromhex("AA 01 93 F9 C0 32 3F FF"))
    assert made.check(frame, True, checker.Strictness.CONTROL, POSTURE, REST, PUSH, 0) is None
    np.testing.assert_allclose(made.torque, JOINT_TO_MOTOR.T @ np.divide((100, -100, 200, -1), 2700), rtol=1e-14)


def test_torque_is_what_the_motors_make_of_it(checker):
    draw = np.random.default_rng(8)
    for _ in range(30):
        units = [int(each) for each in draw.integers(-250, 250, 4)]
        made = make(checker)
        assert asked(made, checker, units) is None
        np.testing.assert_allclose(made.torque, torque_of(units), rtol=1e-13, atol=1e-13)


def test_extreme_units_are_refused(checker):
    for value, place in itertools.product((-8192, -8191, 8191), range(4)):
        units = [value * (i == place) for i in range(4)]
        assert asked(make(checker, WIDE), checker, units) is Reason.MOTOR_TORQUE


def test_each_motor_up_to_its_limit(checker):
    for motor, sign in itertools.product(range(4), (-1, 1)):
        units = [sign * 60 * (i == motor) for i in range(4)]
        most = 60 * (1.0 / IPNM[motor])
        if most < 0.1:
            units, most = [sign * 600 * (i == motor) for i in range(4)], 600 * (1.0 / IPNM[motor])
        limits = [1.6] * 4
        limits[motor] = most
        assert asked(make(checker, replace(WIDE, motor_torque=tuple(limits))), checker, units) is None
        limits[motor] = np.nextafter(most, 0.0)
        assert asked(make(checker, replace(WIDE, motor_torque=tuple(limits))), checker, units) is Reason.MOTOR_TORQUE


def at_the_limit(joint, sign):
    """Units that give one joint a torque, and that torque exactly as floating-point numbers add up."""
    motor = np.zeros(4)
    for i in {0: (0,), 1: (1, 2), 2: (1, 2), 3: (3,)}[joint]:
        motor[i] = -180.0 * sign * (-1.0 if joint == 1 and i == 1 else 1.0)
    m = [each * (1.0 / ipnm) for each, ipnm in zip(motor, IPNM, strict=True)]
    torque = (-42.0 * m[0], 28.25 * m[1] - 28.25 * m[2], -16.8155 * m[1] - 16.8155 * m[2], -18.0 * m[3])
    return [int(each) for each in motor], abs(torque[joint]), torque


def test_each_joint_up_to_its_limit(checker):
    for joint, sign in itertools.product(range(4), (-1, 1)):
        units, most, _ = at_the_limit(joint, sign)
        limits = list(WIDE.joint_torque)
        limits[joint] = most
        made = make(checker, replace(WIDE, joint_torque=tuple(limits)))
        assert asked(made, checker, units) is None
        assert made.torque[joint] == sign * most
        limits[joint] = float(np.nextafter(most, 0.0))
        for how in ("control", "safe"):
            made = make(checker, replace(WIDE, joint_torque=tuple(limits)))
            assert asked(made, checker, units, how) is Reason.JOINT_TORQUE
            assert made.torque == REST


def test_each_rate_up_to_its_limit(checker):
    for joint, sign in itertools.product(range(4), (-1, 1)):
        units, step, _ = at_the_limit(joint, sign)
        rates = [12000.0] * 4
        rates[joint] = step * 2.0**10
        made = make(checker, replace(WIDE, torque_rate=tuple(rates)))
        assert asked(made, checker, units) is None
        # from there on it counts from there: back is allowed, twice that is not, and on again is
        assert asked(made, checker, [-each for each in units]) is Reason.TORQUE_RATE
        assert asked(made, checker, [2 * each for each in units]) is None
        assert asked(made, checker, [0, 0, 0, 0]) is Reason.TORQUE_RATE
        assert asked(made, checker, units) is None
        assert asked(made, checker, [0, 0, 0, 0]) is None
        rates[joint] = float(np.nextafter(rates[joint], 0.0))
        for how in ("control", "safe"):
            made = make(checker, replace(WIDE, torque_rate=tuple(rates)))
            assert asked(made, checker, units, how) is Reason.TORQUE_RATE
            assert made.torque == REST


def test_a_refused_frame_does_not_count(checker):
    made = make(checker, replace(LIMITS, torque_rate=(1000.0,) * 4))
    assert asked(made, checker, [0, 0, 0, -100]) is None
    before = made.torque
    for case in ({"q": (9.0, 0, 0, 0)}, {"qd": (9.0, 0, 0, 0)}, {"force": (90.0, 0, 0)}, {"age": 30}, {"drive": False}):
        assert asked(made, checker, [0, 0, 0, -200], **case) is not None
        assert made.torque == before


def test_without_permission_only_zero_passes(checker):
    for how, drive in (("off", True), ("off", False), ("control", False), ("safe", False)):
        for motor, value in itertools.product(range(4), (-1, 1, 300)):
            made = make(checker)
            assert asked(made, checker, [value * (i == motor) for i in range(4)], how, drive=drive) is Reason.STATE
        # zero passes whatever else is wrong, at once from any torque, and is then where the rate counts from
        made = make(checker, replace(LIMITS, torque_rate=(1000.0,) * 4))
        for _ in range(40):
            units = [
                round(each * ipnm)
                for each, ipnm in zip(
                    np.linalg.solve(JOINT_TO_MOTOR.T, np.add(made.torque, (0, 0.5, 0, 0))), IPNM, strict=True
                )
            ]
            if made.torque[1] < 15.0:
                assert asked(made, checker, units) is None
        assert made.torque[1] > 14.0
        assert asked(made, checker, how="control") is Reason.TORQUE_RATE
        bad = (math.nan,) * 4
        assert asked(made, checker, how=how, drive=drive, q=bad, qd=bad, force=(math.nan,) * 3, age=10**6) is None
        assert made.torque == REST
        assert asked(made, checker) is None


def test_a_mode_that_does_not_exist_drives_nothing(checker):
    made = make(checker)
    for word in ("gravity", "", None, 1):
        assert made.check(frame_of([1, 0, 0, 0]), True, word, POSTURE, REST, PUSH, 0) is Reason.STATE
        assert made.check(frame_of([0, 0, 0, 0]), True, word, POSTURE, REST, PUSH, 0) is None


def test_only_a_packed_torque_passes(checker):
    good = frame_of([0, 0, 0, 0])
    wrong = [good._replace(id=each) for each in (0x400, 0x402, 0x404, 0x001, 0x421, 0x10401, 0)]
    wrong += [Frame(0x401, good.data[:n]) for n in range(8)] + [Frame(0x401, good.data + b"\0")]
    wrong += [Frame(0x401, bytes([first]) + good.data[1:]) for first in range(256) if first != 0xAA]
    made = make(checker)
    for frame in wrong:
        for how, drive in itertools.product(checker.Strictness, (True, False)):
            assert made.check(frame, drive, how, POSTURE, REST, PUSH, 0) is Reason.FRAME


def test_what_the_pucks_said_is_checked_before_motion(checker):
    def built(ipnm=IPNM, pidx=PIDX, T_s=T_S, tool=0.36):
        return checker.Checker(LIMITS, T_s, ipnm, pidx, tool)

    built((2000, 3500, 2000, 3500), (4, 3, 2, 1), 1e-4)
    built(T_s=0.1)
    for motor, units in itertools.product(range(4), (1999, 3501, 0, -2700, math.nan)):
        with pytest.raises(InputError, match=f"IPNM of puck {motor + 1} "):
            built(tuple(units if i == motor else 2700 for i in range(4)))
    for pidx in ((1, 2, 3, 3), (0, 1, 2, 3), (2, 3, 4, 5), (1, 2, 3), (1, 2, 3, 4, 5)):
        with pytest.raises(InputError, match="PIDX"):
            built(pidx=pidx)
    for ipnm in ((2700,) * 3, (2700,) * 5):
        with pytest.raises(InputError, match="PIDX"):
            built(ipnm)
    for T_s in (0.99e-4, 0.1001, math.nan, -1e-3):
        with pytest.raises(InputError, match="T_s"):
            built(T_s=T_s)
    with pytest.raises(InputError, match="tool_length"):
        built(tool=3.6)


def order(to, number, value, size=4):
    return Frame(to, bytes([0x80 | number, 0]) + value.to_bytes(size, "little", signed=True))


def test_service_frames(checker):
    for to in (1, 4, 8, 10, 31, 0x400, 0x404, 0x41F):
        for number in (0, 8, 48, 127):
            assert checker.check_service(Frame(to, bytes([number]))) is None
    lowering = [
        (0x404, 8, 0),
        (0x400, 8, 0),
        (1, 8, 0),
        (2, 8, 0),
        (3, 8, 0),
        (4, 8, 0),
        (10, 8, 0),
        (10, 8, 1),
        (8, 54, 0),
    ]
    for to, number, value in lowering:
        for size in (2, 4):
            assert checker.check_service(order(to, number, value, size)) is None
        for wrong in (value + 2, value - 3, 256):
            assert checker.check_service(order(to, number, wrong)) is Reason.STATE
        assert checker.check_service(order(to, number + 1, value)) is Reason.STATE
    for to, number, value in [
        (0x404, 8, 2),
        (10, 8, 2),
        (1, 42, 100),
        (0x401, 8, 0),
        (10, 42, 1),
        (0x404, 8, 1),
        (4, 5, 2),
        (4, 0, 0),
    ]:
        assert checker.check_service(order(to, number, value)) is Reason.STATE
    for frame in (
        *(Frame(to, b"\x30") for to in (0, 32, 0x3FF, 0x420, 0x423, 0x7FF, 0x1404, -1)),
        Frame(0x404, b""),
        Frame(0x404, b"\x80"),
        Frame(0x404, b"\x88\0"),
        Frame(0x404, b"\x88\0\0"),
        Frame(0x404, b"\x88\0\0\0\0"),
        Frame(0x404, b"\x88\x01\0\0\0\0"),
        Frame(0x404, b"\x08\0\0\0\0\0"),
        Frame(0x404, b"\x88\0\0\0\0\0\0"),
        frame_of([0, 0, 0, 0]),
    ):
        assert checker.check_service(frame) is Reason.FRAME
