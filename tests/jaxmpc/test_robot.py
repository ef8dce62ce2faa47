"""The arm between two samples, against solve_ivp on MuJoCo's dynamics and closed forms; its sensor and its cables."""

import math
from itertools import pairwise
from types import SimpleNamespace

import control
import msgspec
import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxmpc import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.experiment.tables import ArmSettings
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains
from jaxmpc.synthesis.force_filter import cutoff_of, force_filter
from jaxmpc.world import robot as world
from jaxmpc.world.arm import chain, link_inertias, model, tip_at
from jaxmpc.world.cable import fastest_stable
from jaxmpc.world.joint_acceleration import accelerate
from jaxmpc.world.robot import Cable, HeartSample, RobotStructure

FLOATS = SimpleNamespace(
    sin=math.sin,
    cos=math.cos,
    exp=math.exp,
    sqrt=math.sqrt,
    floor=math.floor,
    maximum=max,
    where=lambda condition, this, that: this if condition else that,
    clip=lambda x, low, high: min(max(x, low), high),
    near=lambda angle, other: angle,
    replaced=lambda value, new: new,
)
CHAIN = chain()
STILL = HeartSample((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
QUIET = (0.0, 0.0, 0.0)
NONE = (0.0, 0.0, 0.0, 0.0)


def robot(stiffness=0.0, sensor=None, **arm):
    """No friction, no rounding; keys as in [arm]."""
    arm = ArmSettings(**{"coulomb": NONE, "encoder_counts": 0, "torque_lsb": 0.0, **arm})
    off = {"noise": 0.01, "lsb": (0.0, 0.0, 0.0), "lowpass_hz": 0.0} | (sensor or {})
    base = Experiment.published("table-1")
    sensor = msgspec.structs.replace(base.sensor, **off)
    found = robot_of(msgspec.structs.replace(base, physics="wam", arm=arm, sensor=sensor))
    return found._replace(tissue=found.tissue._replace(stiffness=stiffness))


def run(kind, of, state, torque, seconds, of_chain=CHAIN, advance=accelerate):
    """States after each step under constant torques."""
    states = []
    for _ in range(round(seconds / of.measurement.T_s)):
        state = state._replace(pending=(torque, torque))
        state = world.move(of_chain, kind, of, state, torque, (STILL,) * kind.substeps, advance, FLOATS)
        states.append(state)
    return states


def without_velocity_products(of_chain, q, qd, torque, tool_mass, viscous, share, ops):
    """`accelerate` of an arm without Coriolis and centripetal torques."""
    rest = tuple(tau - D * v for tau, D, v in zip(torque, viscous, qd, strict=True))
    return accelerate(of_chain, q, NONE, rest, tool_mass, viscous, share, ops)


def continuous(of, state, torque, at, coriolis):
    """Joint angles of the same arm by DOP853, on C MuJoCo's mass matrix and torques."""
    compiled = model()
    data, site = mujoco.MjData(compiled), compiled.site("tip").id
    J, M = np.zeros((3, 7)), np.zeros((7, 7))

    def rates(_, x):
        data.qpos[:4], data.qvel[:4] = x[:4], x[4:] * coriolis
        mujoco.mj_fwdPosition(compiled, data)
        mujoco.mj_fwdVelocity(compiled, data)
        mujoco.mj_jacSite(compiled, data, J, None, site)
        mujoco.mj_fullM(compiled, data, M)
        y = of.tissue.stiffness * (data.site_xpos[site] - of.touch)
        rest = torque - J[:, :4].T @ y - data.qfrc_bias[:4] - compiled.dof_damping[:4] * x[4:]
        return np.concatenate([x[4:], np.linalg.solve(M[:4, :4], rest)])

    begin = np.concatenate([state.q, state.qd])
    return solve_ivp(rates, (0.0, at[-1] + 1e-9), begin, "DOP853", at, rtol=1e-11, atol=1e-12).y[:4].T


def tip_errors(integrator, case, coriolis=True):
    """Largest distance of the tip from the continuous one in 0.15 s, in steps of 2 and 1 ms [m]."""
    stiffness, speed, push = case
    errors = []
    for T_s in (2e-3, 1e-3):
        of = robot(stiffness, integrator=integrator)
        of = of._replace(measurement=of.measurement._replace(T_s=T_s))
        kind = RobotStructure(integrator=integrator)
        state = world.init(CHAIN, kind, of, 0.0, FLOATS)._replace(qd=speed)
        torque = tuple(held + more for held, more in zip(state.pending[0], push, strict=True))
        advance = accelerate if coriolis else without_velocity_products
        q = np.array([each.q for each in run(kind, of, state, torque, 0.15, advance=advance)])
        wanted = continuous(of, state, torque, T_s * np.arange(1, len(q) + 1), coriolis)
        errors.append(max(np.linalg.norm(tip_at(a) - tip_at(b)) for a, b in zip(q, wanted, strict=True)))
    return np.array(errors)


SWING = (0.0, (0.5, -0.5, 1.0, 1.0), (2.0, -5.0, 1.0, 1.0))
CONTACT = (1900.0, NONE, (1.0, 2.0, -0.5, 1.0))
"""Stiffness [N/m], joint velocities at the start [rad/s], torques beyond those that hold [N m]."""


@pytest.mark.parametrize("case", [SWING, CONTACT])
def test_leapfrog_is_second_order_in_gravity_damping_and_contact(case):
    """Half the step, a quarter of the error, to the next order's 5 %."""
    coarse, fine = tip_errors("leapfrog", case, coriolis=False)
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


def test_what_the_velocity_products_leave_is_first_order_and_small():
    """They are taken at the start of a step. Pressing 5 N on foam: beside the second order's, and below 2 µm."""
    coarse, fine = tip_errors("leapfrog", CONTACT)
    assert coarse / fine > 3.4
    assert fine < 2e-6
    coarse, fine = tip_errors("leapfrog", SWING)
    assert coarse / fine == pytest.approx(2.0, rel=0.05)
    assert fine < 2e-4


@pytest.mark.parametrize("case", [SWING, CONTACT])
def test_euler_is_first_order(case):
    coarse, fine = tip_errors("euler", case)
    assert coarse / fine == pytest.approx(2.0, rel=0.05)


def test_substeps_are_shorter_steps():
    """Two of 0.5 ms in a sample of 1 ms, or two samples of 0.5 ms; only the order of sums differs."""
    of = robot(1900.0)
    state = world.init(CHAIN, RobotStructure(), of, 0.0, FLOATS)
    torque = tuple(held + 1.0 for held in state.pending[0])
    two = run(RobotStructure(substeps=2), of, state, torque, 0.02)
    half = of._replace(measurement=of.measurement._replace(T_s=5e-4))
    np.testing.assert_allclose(
        [each.q for each in two], [each.q for each in run(RobotStructure(), half, state, torque, 0.02)[1::2]]
    )


@pytest.mark.parametrize(
    ("joint", "hertz", "ratio"), [(0, 15.0, 0.05), (1, 20.0, 0.03), (2, 20.0, 0.1), (3, 60.0, 0.05)]
)
def test_a_cable_rings_at_its_frequency_against_a_locked_motor(joint, hertz, ratio):
    """Zero crossings and decrement of one link, the others and all motors held by inertia, without gravity.

    Frequency to 0.5 %: a step of 1/100 of a period moves it by 0.02 %, the damper, taken at the start of a step, by
    ½ ω h ζ = 0.3 %. Damping to 2 %.
    """
    T_s = 0.01 / hertz
    of = robot(cable_hz=hertz, cable_damping=ratio, viscous=NONE)
    of = of._replace(measurement=of.measurement._replace(T_s=T_s))
    heavy = tuple(1e9 for _ in range(4))
    locked = CHAIN._replace(armature=heavy, gravity=(0.0, 0.0, 0.0))
    held = tuple(0.0 if i == joint else 1e9 for i in range(4))

    def one_link(of_chain, *rest):
        return accelerate(of_chain._replace(armature=held), *rest)

    kind = RobotStructure(cable=True)
    state = world.init(locked, kind, of, 0.0, FLOATS)
    amplitude = 1e-4
    state = state._replace(q=tuple(x + amplitude * (i == joint) for i, x in enumerate(state.q)))
    states = run(kind, of, state, NONE, 3.3 / hertz, locked, one_link)
    x = np.array([each.q[joint] for each in states]) - of.posture[joint]
    down = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0))
    crossing = down + x[down] / (x[down] - x[down + 1])
    period = T_s * np.diff(crossing).mean()
    peaks = [x[a:b].max() for a, b in pairwise(down)]
    decrement = np.log(peaks[0] / peaks[1])
    found = decrement / np.hypot(2.0 * np.pi, decrement)
    assert found == pytest.approx(ratio, rel=0.02)
    assert 1.0 / period / np.sqrt(1.0 - found**2) == pytest.approx(hertz, rel=0.005)


@pytest.mark.parametrize("posture", [(0.0, 0.7, 0.0, 2.2), (-1.9, 0.89, 0.14, 0.36)])
@pytest.mark.parametrize("damping", [0.0, 0.05, 1.0])
def test_steps_are_stable_up_to_the_cable_mode_that_is_told(posture, damping):
    """A free arm without gravity, a hair from rest: 7 % below it stays there, 7 % above it is gone."""
    floating, kind = CHAIN._replace(gravity=(0.0, 0.0, 0.0)), RobotStructure(cable=True)
    highest = fastest_stable(posture, 0.5, damping, 1e-3)
    for share, stays in ((0.93, True), (1.07, False)):
        of = robot(cable_hz=1.0, viscous=NONE, posture=posture, tool_mass=0.5)
        omega = 2.0 * math.pi * share * highest
        springs = tuple(omega**2 * inertia for inertia in link_inertias(posture))
        of = of._replace(cable=Cable(springs, tuple(2.0 * damping / omega * each for each in springs)))
        state = world.init(floating, kind, of, 0.0, FLOATS)
        state = state._replace(q=tuple(x + 1e-9 * (i + 1.0) for i, x in enumerate(state.q)))
        stretched = 0.0
        for _ in range(80):
            (state,) = run(kind, of, state, NONE, 1e-3, floating)
            stretched = max(abs(theta - q) for theta, q in zip(state.motor[0], state.q, strict=True))
            if stretched > 1e-7:
                break
        assert (stretched < 1e-7) == stays


@pytest.mark.oracle
def test_a_stiffer_cable_comes_closer_to_the_rigid_arm():
    """Twice the frequency, a quarter of the stretch; in steps of 0.25 ms, fine enough for 80 Hz."""

    def tips(hertz):
        kind, of = (
            RobotStructure(cable=hertz > 0.0, substeps=4),
            robot(810.0, cable_hz=hertz, cable_damping=0.5, substeps=4),
        )
        state = world.init(CHAIN, kind, of, 0.0, FLOATS)
        # Half a sine of torque, so that the cables hardly ring.
        states, hold = [], state.pending[0]
        for k in range(60):
            push = math.sin(math.pi * (k + 0.5) / 60.0) ** 2
            torque = tuple(tau + more * push for tau, more in zip(hold, (2.0, 4.0, 1.0, 1.0), strict=True))
            state = run(kind, of, state, torque, 1e-3)[0]
            states.append(tip_at(state.q))
        return np.array(states)

    rigid = tips(0.0)
    away = [np.linalg.norm(tips(hertz) - rigid, axis=1).max() for hertz in (20.0, 40.0, 80.0)]
    assert np.array(away[:-1]) / away[1:] == pytest.approx([4.0, 4.0], rel=0.25)


def test_a_cable_begins_wound_up_and_at_rest():
    """Held against gravity, nothing moves: 1e-12 rad in ten steps."""
    kind, of = RobotStructure(cable=True), robot(cable_hz=20.0)
    state = world.init(CHAIN, kind, of, 0.0, FLOATS)
    after = run(kind, of, state, state.pending[0], 0.01)[-1]
    np.testing.assert_allclose(after.q, of.posture, atol=1e-12)
    np.testing.assert_allclose(after.motor[0], state.motor[0], atol=1e-12)
    assert abs(state.motor[0][1] - of.posture[1]) > 1e-4


@pytest.mark.parametrize(("rate_change", "noise"), [(1.0, 0.01), (20.0, 0.01), (0.1, 0.05)])
def test_gains_of_the_force_filter(rate_change, noise):
    """An iterated Riccati recursion, and python-control, whose gain also predicts: A K."""
    A, C, Q = np.array([[1.0, 1e-3], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([0.0, rate_change**2])
    P = np.eye(2)
    for _ in range(20_000):
        K = P @ C.T / (C @ P @ C.T + noise**2)
        P = A @ (P - K @ C @ P) @ A.T + Q
    found = force_filter(cutoff_of(rate_change, noise, 1e-3), 1e-3, FLOATS)[1:]
    np.testing.assert_allclose(found, K[:, 0], rtol=1e-8)
    predicting = control.dlqe(A, np.eye(2), C, Q, [[noise**2]])[0]
    np.testing.assert_allclose(A @ np.array(found), np.asarray(predicting)[:, 0], rtol=1e-8)


def readings(kind, of, heart_at, count):
    """What the sensor says of a heart moving under a still arm."""
    state, said = world.init(CHAIN, kind, of, 0.0, FLOATS), []
    for k in range(count):
        force, _, _, _, state = world.sense(CHAIN, kind, of, state, heart_at(k), QUIET, FLOATS)
        said.append(force)
    return np.array(said)


def test_the_force_filter_is_the_kalman_filter():
    """A falling force, against the filter written as matrices."""
    constants, t = force_filter(cutoff_of(20.0, 0.01, 1e-3), 1e-3, FLOATS), np.arange(200) * 1e-3
    gains = Gains((0.0,) * 2, (0.0,) * 2, (0.0,) * 4, (0.0,) * 3, 1.0, (0.0,), (0.0,) * 2, 0.0, force_filter=constants)
    state, K, x = cascade.init(gains), np.array(constants[1:]), np.zeros(2)
    for force in 8.1 * t + 0.81 * t**2:
        state, said = cascade.filter_force(gains, state, force)
        x = np.array([[1.0, 1e-3], [0.0, 1.0]]) @ x
        x = x + K * (force - x[0])
        assert said == pytest.approx(x[0], abs=1e-12)
    # It follows a ramp that hardly bends without lag.
    assert said == pytest.approx(force, rel=1e-3)
    assert cascade.expected_force(gains, state) == state.filtered.force + 1e-3 * state.filtered.rate


def test_low_pass_and_counts_of_the_sensor():
    """A step of 1 N through 500 Hz, then rounded to 6.1 and 12.2 mN; rounding is half up."""
    sensor = {"lowpass_hz": 500.0, "lsb": (0.0061, 0.0061, 0.0122)}
    of = robot(1000.0, sensor=sensor)
    said = readings(RobotStructure(), of, lambda k: HeartSample((-1e-3, 0.0, 1e-3), QUIET), 5)
    smooth = 1.0 - np.exp(-2.0 * np.pi * 500.0 * 1e-3 * np.arange(1, 6))
    for axis, (lsb, force) in enumerate([(0.0061, smooth), (0.0061, 0.0 * smooth), (0.0122, -smooth)]):
        np.testing.assert_allclose(said[:, axis], np.floor(force / lsb + 0.5) * lsb, atol=1e-12)


def test_tool_beyond_the_sensor_reads_its_inertia_and_no_weight():
    """m a: the change of tip velocity per sample, against second differences of MuJoCo's tip positions, to O(T_s)."""
    m, kind = 0.05, RobotStructure(tool_inertia=True)
    of = robot(0.0, beyond_sensor=m)
    state, said, q = world.init(CHAIN, kind, of, 0.0, FLOATS), [], []
    torque = tuple(held + 2.0 for held in state.pending[0])
    state = state._replace(pending=(torque, torque))
    for _ in range(30):
        force, _, _, _, state = world.sense(CHAIN, kind, of, state, STILL, QUIET, FLOATS)
        said.append(force)
        q.append(state.q)
        state = run(kind, of, state, torque, 1e-3)[0]
    assert said[0] == (0.0, 0.0, 0.0)
    second = np.diff([tip_at(each) for each in q], 2, axis=0) / 1e-6
    mean = 0.5 * (np.array(said)[2:] + np.array(said)[1:-1])
    np.testing.assert_allclose(mean, m * second, atol=0.01 * m * np.abs(second).max())
