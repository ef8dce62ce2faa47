"""Encoders, velocity filter and torque command of the drives; straight-through steps."""

import math

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from hypothesis import given

from jaxmpc.law import measurement
from jaxmpc.law.measurement import Measurement, lowpass_pole
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.world import drive as drives
from jaxmpc.world.drive import Drive
from jaxmpc.xla import ops

T = np.array(JOINT_TO_MOTOR)
WAM = Drive(2.0 * math.pi / 4096, 1.0 / 2700.0)
PERFECT = Drive(0.0, 0.0)
MEASUREMENT = Measurement(1e-3, math.exp(-0.18))
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 4)
torques = st.tuples(*[st.floats(-150.0, 150.0)] * 4)


def test_the_differential_and_its_inverse():
    """libbarrett's matrices; 16.8155 is 28.25 over 1.68."""
    np.testing.assert_allclose(T @ np.array(MOTOR_TO_JOINT), np.eye(4), atol=1e-15)
    printed = [[-42, 0, 0, 0], [0, 28.25, -16.8155, 0], [0, -28.25, -16.8155, 0], [0, 0, 0, -18]]
    np.testing.assert_array_equal(T, printed)
    # Reflected through it, the drives of wam4.conf are the armature of the MJCF, to its five digits.
    reflected = T.T @ np.diag([1.1631e-4, 1.1831e-4, 1.1831e-4, 1.0686e-4]) @ T
    np.testing.assert_allclose(reflected, np.diag([0.20517, 0.18884, 0.06691, 0.03462]), atol=0.6e-5)


@given(q=angles)
def test_an_encoder_is_at_most_half_a_count_off_at_its_motor(q):
    """1e-9 counts for the rounding of angles up to 2e5 counts."""
    read = np.array(drives.read(WAM, q, FLOATS))
    counts = T @ read / WAM.angle_lsb
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(counts - T @ np.array(q) / WAM.angle_lsb).max() <= 0.5 + 1e-9


def test_a_count_of_one_motor_moves_two_joints():
    """2.7e-5 and 4.6e-5 rad at J2 and J3, the reference's figures."""
    at = np.array(MOTOR_TO_JOINT) @ (np.array([0.0, 1.0, 0.0, 0.0]) * WAM.angle_lsb)
    read = np.array(drives.read(WAM, tuple(at.tolist()), FLOATS))
    np.testing.assert_allclose(np.abs(read), [0.0, 2.7e-5, 4.6e-5, 0.0], atol=0.05e-5)
    short = drives.read(WAM, tuple((0.49 * at).tolist()), FLOATS)
    assert short == (0.0, 0.0, 0.0, 0.0)


def test_perfect_encoders_change_nothing():
    q = (0.1, -0.7, 0.3, 2.2)
    np.testing.assert_allclose(drives.read(PERFECT, q, FLOATS), q, rtol=1e-14)
    assert (drives.angle_lsb(0), lowpass_pole(0.0, 1e-3, FLOATS)) == (0.0, 0.0)
    assert drives.angle_lsb(4096) == WAM.angle_lsb
    assert lowpass_pole(180.0, 1e-3, FLOATS) == MEASUREMENT.velocity_pole


def test_velocities_are_scipys_filter_of_differences():
    """First order at 180 rad/s on backward differences of quantised angles, from rest."""
    t = np.arange(500) * 1e-3
    path = 0.7 + 0.3 * np.sin(2 * np.pi * np.outer(t, [0.5, 1.0, 2.0, 3.0]))
    first = drives.read(WAM, tuple(path[0].tolist()), FLOATS)
    state, found = measurement.init(first), []
    for q in path.tolist():
        state = measurement.measure(MEASUREMENT, state, drives.read(WAM, tuple(q), FLOATS))
        found.append(state)
    angle = np.array([each.angle for each in found])
    raw = np.diff(angle, axis=0, prepend=[first]) / 1e-3
    wanted = scipy.signal.lfilter([1.0 - MEASUREMENT.velocity_pole], [1.0, -MEASUREMENT.velocity_pole], raw, axis=0)
    np.testing.assert_allclose([each.velocity for each in found], wanted, atol=1e-12)
    np.testing.assert_allclose(angle, np.floor(path @ T.T / WAM.angle_lsb + 0.5) * WAM.angle_lsb @ np.linalg.inv(T).T)


@given(torque=torques)
def test_a_torque_is_rounded_down_at_the_motors(torque):
    """Cut to whole units; 1e-9 units for rounding."""
    sent = np.linalg.solve(T.T, np.array(drives.send(WAM, torque, FLOATS)))
    units = sent * 2700.0
    np.testing.assert_allclose(units, np.round(units), atol=1e-9)
    lost = np.linalg.solve(T.T, np.array(torque)) * 2700.0 - units
    assert lost.min() > -1e-9
    assert lost.max() < 1.0 + 1e-9


def test_a_batch_is_its_rows():
    """Encoders and torque units on in one row and off in the other."""
    mixed = WAM._replace(angle_lsb=np.array([WAM.angle_lsb, 0.0]), torque_lsb=np.array([WAM.torque_lsb, 0.0]))
    q, torque = (0.1, 0.7, -0.2, 2.2), (3.0, -4.0, 5.0, 0.3)
    rows = (WAM, WAM._replace(angle_lsb=0.0, torque_lsb=0.0))
    for i, row in enumerate(rows):
        np.testing.assert_allclose(np.array(drives.read(mixed, q, np))[:, i], drives.read(row, q, FLOATS), rtol=1e-14)
        batch, alone = drives.send(mixed, torque, np), drives.send(row, torque, FLOATS)
        np.testing.assert_allclose([np.broadcast_to(x, 2)[i] for x in batch], alone, rtol=1e-14)


@pytest.mark.parametrize("value", [-2.3, 0.0, 0.7, 5.0])
def test_steps_are_straight_through_in_both_modes(value):
    """Values are floor's and those that took another's place; slopes are 1 throughout. A clip has its own slope."""
    x, held = jnp.float64(value), min(max(value, -1.0), 1.0)
    assert ops.floor(x) == math.floor(value)
    assert ops.replaced(x, jnp.float64(held)) == held
    assert ops.clip(x, -1.0, 1.0) == held
    for derivative in (jax.jacfwd, jax.jacrev):
        assert derivative(ops.floor)(x) == 1.0
        assert [float(derivative(ops.replaced, i)(x, jnp.float64(held))) for i in range(2)] == [1.0, 0.0]
        assert [float(derivative(ops.clip, i)(x, -1.0, 1.0)) for i in range(3)] == [
            float(value == held),
            float(value < held),
            float(value > held),
        ]


def test_slopes_of_the_drives_are_those_of_perfect_ones():
    """A tuner must see the loop through its counts."""
    q, torque = (0.1, 0.7, -0.2, 2.2), (100.0, -4.0, 5.0, 0.3)
    for drive in (WAM, PERFECT):
        read = jax.jacrev(lambda q, d=drive: jnp.stack(drives.read(d, q, ops)))(q)
        np.testing.assert_allclose(np.stack(read, 1), np.eye(4), atol=1e-14)
        sent = jax.jacrev(lambda x, d=drive: jnp.stack(drives.send(d, x, ops)))(torque)
        np.testing.assert_allclose(np.stack(sent, 1), np.eye(4), atol=1e-14)
