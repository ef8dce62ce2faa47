"""Whatever is wanted: what clamp, rounding and packing make of it is accepted by the independent checker."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.controller.limits import ROWS, Limits
from deploy.puck import codec
from deploy.safety.checker import Checker, Strictness
from deploy.safety.clamp import bounds, clamp
from deploy.safety.kinematics import kinematics
from jaxmpc.files.errors import InputError
from jaxmpc.law import chain as law
from jaxmpc.world import arm

T_S, TOOL = 1e-3, 0.36
POSTURE, REST = (0.0, 0.7, 0.0, 2.2), (0.0,) * 4
DEFAULT = Limits.default(kinematics(TOOL)(POSTURE, REST).tip)
JOINT_TO_MOTOR = np.array([[-42, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18]])
TO_MOTOR = np.linalg.inv(JOINT_TO_MOTOR.T)


class Sender:
    """From wanted torques to the frame, as the loop does it, and the checker behind it."""

    def __init__(self, limits, ipnm=(2700,) * 4, pidx=(1, 2, 3, 4)):
        self.limits, self.ipnm, self.order = limits, np.array(ipnm), np.argsort(pidx)
        self.within = bounds(limits, T_S, ipnm)
        self.checker = Checker(limits, T_S, ipnm, pidx, TOOL)

    def send(self, wanted, how=Strictness.SAFE, q=POSTURE, qd=REST, force=None, age=0):
        """The reason against it, and the units of motors 1–4."""
        torque, _ = clamp(wanted, self.checker.torque, self.within)
        units = np.floor(TO_MOTOR @ torque * self.ipnm).astype(int)
        frame = codec.pack_torques(units[self.order].tolist())
        return self.checker.check(frame, True, how, q, qd, force, age), units


def worst(limits, ipnm, units):
    """Largest shares of each limit that a run of frames used, by arithmetic of its own."""
    motors = np.concatenate([np.zeros((1, 4)), np.array(units)]) / ipnm
    torque = motors @ JOINT_TO_MOTOR
    rate = np.abs(np.diff(torque, axis=0)) / T_S
    most = (np.abs(torque) / limits.joint_torque, np.abs(motors) / limits.motor_torque, rate / limits.torque_rate)
    return [float(np.max(each)) for each in most]


def states(draw, n):
    """Joint angles and velocities of every kind, and forces; a third of them within all the default limits."""
    near = draw.uniform(size=n) < 0.4
    q = np.where(near[:, None], POSTURE + draw.uniform(-0.05, 0.05, (n, 4)), draw.uniform(-3.5, 3.5, (n, 4)))
    qd = np.where(near[:, None], draw.uniform(-0.2, 0.2, (n, 4)), draw.uniform(-5.0, 5.0, (n, 4)))
    return near.tolist(), list(map(tuple, q.tolist())), list(map(tuple, qd.tolist()))


def commands(draw, n):
    """Wanted torques: steps, noise, ramps and spikes far beyond every limit, and some that are not finite."""
    slow = np.cumsum(draw.normal(0.0, 0.3, (n, 4)), axis=0)
    slow = 30.0 * np.sin(slow / 8.0)
    scale = draw.choice([0.0, 1.0, 10.0, 100.0, 1e6, 1e300], (n, 1), p=[0.1, 0.3, 0.3, 0.2, 0.05, 0.05])
    wanted = np.where(draw.uniform(size=(n, 1)) < 0.5, slow, scale * draw.normal(size=(n, 4)))
    wanted[draw.uniform(size=(n, 4)) < 0.001] = np.nan
    wanted[draw.uniform(size=(n, 4)) < 0.001] = np.inf
    return list(map(tuple, wanted.tolist()))


SHARED = replace(DEFAULT, motor_torque=(0.5, 0.3, 0.25, 0.6), torque_rate=(600.0, 700.0, 300.0, 500.0))


def bulk(n, limits, seed):
    draw = np.random.default_rng(seed)
    sender = Sender(limits, (2472, 2562, 2700, 2755), (3, 1, 4, 2))
    near, q, qd = states(draw, n)
    units, refused = [], []
    for k, wanted in enumerate(commands(draw, n)):
        how = Strictness.CONTROL if near[k] else Strictness.SAFE
        reason, sent = sender.send(wanted, how, q[k], qd[k], (0.0, 1.0, -5.0), 0 if near[k] else 20)
        if reason is not None:
            refused.append((k, reason))
        units.append(sent)
    assert refused == []
    shares = worst(limits, sender.ipnm, units)
    # none above its limit, and the walk has really been at each of torque, motors (where they bind) and rate
    assert max(shares) <= 1.0 + 1e-12
    assert shares[0] > 0.98 or shares[1] > 0.98
    assert shares[2] > 0.98


@pytest.mark.parametrize("limits", [DEFAULT, SHARED], ids=["default", "shared-motors-bind"])
def test_everything_that_is_sent_is_accepted(limits):
    bulk(40_000, limits, seed=21)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [DEFAULT, SHARED], ids=["default", "shared-motors-bind"])
def test_everything_that_is_sent_is_accepted_a_million_times(limits):
    bulk(500_000, limits, seed=22)


def four(low, high):
    return st.tuples(*(st.floats(a, b) for a, b in zip(low, high, strict=True)))


@settings(max_examples=60)
@given(
    joint_torque=four((5.0,) * 4, ROWS["joint_torque"].highest),
    motor_torque=four((0.2,) * 4, ROWS["motor_torque"].highest),
    torque_rate=four(ROWS["torque_rate"].lowest, ROWS["torque_rate"].highest),
    ipnm=st.tuples(*[st.integers(2000, 3500)] * 4),
    pidx=st.permutations([1, 2, 3, 4]),
    wanted=st.lists(st.tuples(*[st.floats() | st.floats(-60.0, 60.0)] * 4), min_size=1, max_size=12),
)
def test_for_any_limits_and_pucks(joint_torque, motor_torque, torque_rate, ipnm, pidx, wanted):
    limits = replace(DEFAULT, joint_torque=joint_torque, motor_torque=motor_torque, torque_rate=torque_rate)
    try:
        sender = Sender(limits, ipnm, pidx)
    except InputError as error:
        if error.key.startswith("limits.torque_rate"):
            return
        raise
    for each in wanted:
        # three times, so that limits are reached from where they are near
        for _ in range(3):
            assert sender.send(each)[0] is None
    # zero is reached by steps that are all accepted
    steps = 0
    while np.max(np.abs(sender.checker.torque)) > 0.05:
        assert sender.send(REST)[0] is None
        steps += 1
        assert steps < 2000


@given(st.binary(min_size=0, max_size=9), st.integers(0, 0x7FF), st.sampled_from(list(Strictness)))
def test_no_bytes_make_the_checker_raise(data, identifier, how):
    frame = codec.Frame(identifier, data)
    for each in (frame, frame._replace(id=0x401), codec.Frame(0x401, b"\xaa" + data[:7].ljust(7, b"\0"))):
        Sender(DEFAULT).checker.check(each, True, how, POSTURE, REST, None, 0)


def test_its_kinematics_are_those_of_the_controller():
    chain, motion = arm.chain(), kinematics(TOOL)
    draw = np.random.default_rng(23)
    from deploy.runtime.straightline import OPS

    for _ in range(300):
        q, qd = tuple(draw.uniform(-3.0, 3.0, 4).tolist()), tuple(draw.normal(size=4).tolist())
        tip = law.tip(chain, law.pose(chain, q, OPS))
        found, jacobian = motion(q, qd), np.array(tip.jacobian)
        # MuJoCo normalises the MJCF's quaternions, which leaves 1e-16 of rotation
        np.testing.assert_allclose(found.tip, tip.position, atol=1e-14)
        assert found.tip_speed == pytest.approx(np.linalg.norm(jacobian @ qd), abs=1e-13)
        assert found.least_singular_value == pytest.approx(np.linalg.svd(jacobian)[1][2], abs=1e-7)
        assert math.isfinite(found.elbow_speed)
