"""Kinematics and dynamics of the arm against C MuJoCo, printed figures and numpy."""

import math
from types import SimpleNamespace

import hypothesis.strategies as st
import mujoco
import numpy as np
import pytest
from hypothesis import given

from jaxmpc.law import chain as arm
from jaxmpc.law.scalar import factor_ldl, solve_ldl
from jaxmpc.world.arm import TOOL_MASS, chain, joint_ranges, mjcf, model, tip_at

RELATIVE = 1e-11
"""Of the largest entry over all states: some hundred roundings of 1e-16, on entries up to 1e3 of the smallest."""
CHAIN = chain()
BARE = arm.with_point_mass(CHAIN, -TOOL_MASS)
"""Without tool; 0.07 g m² of its rotational inertia stay, which gravity does not feel."""
PI = math.pi


def random_states(count):
    rng = np.random.default_rng(0)
    low, high = joint_ranges().T
    return rng.uniform(low, high, (count, 4)), rng.normal(0.0, 2.0, (count, 4)), rng.normal(0.0, 5.0, (count, 4))


def mujocos(compiled, q, qd, qdd):
    """M without armature, bias, tip, Jacobian, J̇q̇ and inverse dynamics, each (states, …)."""
    data, site = mujoco.MjData(compiled), compiled.site("tip").id
    body, rows = int(compiled.site_bodyid[site]), []
    M, J, Jdot = np.zeros((7, 7)), np.zeros((3, 7)), np.zeros((3, 7))
    for angles, rates, accelerations in zip(q, qd, qdd, strict=True):
        data.qpos[:4], data.qvel[:4], data.qacc[:4] = angles, rates, accelerations
        mujoco.mj_inverse(compiled, data)
        mujoco.mj_fullM(compiled, data, M)
        mujoco.mj_jacSite(compiled, data, J, None, site)
        mujoco.mj_jacDot(compiled, data, Jdot, None, data.site_xpos[site], body)
        # MuJoCo's inverse also pays for drives and dampers.
        torque = data.qfrc_inverse[:4] - compiled.dof_armature[:4] * accelerations + data.qfrc_passive[:4]
        links = M[:4, :4] - np.diag(compiled.dof_armature[:4])
        found = (links, data.qfrc_bias[:4], data.site_xpos[site], J[:, :4], Jdot[:, :4] @ rates, torque)
        rows.append([np.array(value) for value in found])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def ours(of, q, qd, qdd):
    rows = []
    for angles, rates, accelerations in zip(q.tolist(), qd.tolist(), qdd.tolist(), strict=True):
        at = arm.pose(of, tuple(angles), math)
        found, tip = arm.dynamics(of, at, tuple(rates)), arm.tip(of, at)
        torque = arm.inverse_dynamics(of, at, tuple(rates), tuple(accelerations))
        rows.append([np.array(value) for value in (*found[:2], *tip, found.drift, torque)])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def check(of, compiled, states):
    names = ("mass", "bias", "tip", "jacobian", "drift", "torque")
    for name, found, wanted in zip(names, ours(of, *states), mujocos(compiled, *states), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=RELATIVE * np.abs(wanted).max(), err_msg=name)


@pytest.mark.oracle
def test_kinematics_and_dynamics_are_mujocos():
    check(CHAIN, model(), random_states(1000))


@pytest.mark.parametrize("mass", [0.7, -0.1])
def test_a_point_mass_is_a_heavier_tool(mass):
    """In the MJCF the tool's centre is the tip, so only its mass differs."""
    spec = mujoco.MjSpec.from_string(mjcf())
    spec.body("tool").mass += mass
    check(arm.with_point_mass(CHAIN, mass), spec.compile(), random_states(50))


@pytest.mark.parametrize(
    ("q", "elbow", "root", "short", "long"),
    [
        ((0, 0, 0, 0), (0.045, 0, 0.55), (0, 0, 0.55), (0, 0, 0.9), (0, 0, 0.91)),
        (
            (0, -2, 0, 3.13),
            (-0.51884, 0, -0.18796),
            (-0.53804, 0, -0.14726),
            (-0.22150, 0, 0.00207),
            (-0.21245, 0, 0.00633),
        ),
        (
            (0, -1.99, 0, 3.14),
            (-0.52069, 0, -0.18276),
            (-0.53908, 0, -0.14169),
            (-0.21961, 0, 0.00128),
            (-0.21048, 0, 0.00537),
        ),
        ((0, PI / 2, 0, 0), (0.55, 0, -0.045), (0.55, 0, 0), (0.9, 0, 0), (0.91, 0, 0)),
        ((PI / 2, PI / 2, 0, 0), (0, 0.55, -0.045), (0, 0.55, 0), (0, 0.9, 0), (0, 0.91, 0)),
        ((0, 0, 0, PI / 2), (0.045, 0, 0.55), (0.045, 0, 0.595), (0.395, 0, 0.595), (0.405, 0, 0.595)),
        (
            (0.3, -0.7, 0.5, 1.9),
            (-0.31602, -0.07517, 0.44610),
            (-0.33496, -0.07373, 0.48690),
            (-0.09986, 0.16520, 0.58760),
            (-0.09315, 0.17203, 0.59048),
        ),
    ],
)
def test_points_of_the_forearm_to_the_printed_digit(q, elbow, root, short, long):
    """The forearm's joint frame stands on the elbow axis, −y along the forearm: half a unit of the fifth digit.

    And 7 % more: for x in the last row DH matrices too give −0.3160147 and −0.3349549.
    """
    q = tuple(map(float, q))
    for at, wanted in (
        ((0.0, 0.0, 0.0), elbow),
        ((-0.045, 0.0, 0.0), root),
        ((-0.045, -0.35, 0.0), short),
        ((-0.045, -0.36, 0.0), long),
    ):
        moved = CHAIN._replace(tip=at)
        np.testing.assert_allclose(arm.tip(moved, arm.pose(moved, q, math)).position, wanted, rtol=0, atol=0.535e-5)
    np.testing.assert_allclose(tip_at(q), long, rtol=0, atol=0.535e-5)


def holding(q):
    return np.array(arm.inverse_dynamics(BARE, arm.pose(BARE, tuple(map(float, q)), math), (0.0,) * 4, (0.0,) * 4))


@pytest.mark.parametrize(
    ("q", "printed", "unit"),
    [
        ((0, 0, 0, 0), (-0.143, 0, 0.356), (1e-3, 1e-3, 1e-3)),
        ((0, PI / 2, 0, 0), (-13.85, 0, -1.468), (1e-2, 1e-3, 1e-3)),
        ((0, -2, 0, 3.13), (10.29, 0, -1.176), (1e-2, 1e-3, 1e-3)),
        ((0, 0, 0, PI / 2), (-1.967, 0, -1.468), (1e-3, 1e-3, 1e-3)),
        ((0, -PI / 2, 0, PI / 2), (12.74, 0, 0.356), (1e-2, 1e-3, 1e-3)),
        ((0, -PI / 2, -PI / 2, PI / 2), (12.74, 2.057, 0), (1e-2, 1e-3, 1e-3)),
    ],
)
def test_gravity_torques_to_the_printed_digit(q, printed, unit):
    found = holding(q)
    assert abs(found[0]) < 1e-12
    assert (np.abs(found[1:] - printed) <= 0.501 * np.array(unit)).all()


def inertia(q):
    return np.array(
        arm.with_diagonal(arm.mass_matrix(BARE, arm.pose(BARE, tuple(map(float, q)), math)), CHAIN.armature)
    )


def test_mass_matrix_to_the_printed_digits():
    """1.5e-4: half a unit of the last digit and the tool's own 0.7e-4 kg m², which a point mass does not take away."""
    near = {"rtol": 0, "atol": 1.5e-4}
    straight, home = inertia((0, 0, 0, 0)), inertia((0, -2, 0, 3.13))
    np.testing.assert_allclose(straight.diagonal(), (0.3434, 1.0013, 0.0723, 0.0758), **near)
    np.testing.assert_allclose(straight[1, 3], 0.1219, **near)
    np.testing.assert_allclose(inertia((0, PI / 2, 0, 0))[0, 0], 1.1416, **near)
    np.testing.assert_allclose(home.diagonal(), (0.7628, 0.6791, 0.0792, 0.0758), **near)


def test_products_of_inertia_have_the_right_sign():
    """Turned round they give −0.1155."""
    assert inertia((0, -PI / 2, 0, PI / 2))[0, 2] == pytest.approx(-0.1237, abs=1.5e-4)


@given(
    n=st.integers(1, 5),
    seed=st.integers(0, 2**32 - 1),
    spread=st.floats(0.0, 3.0),
)
def test_ldl_is_numpys_solution(n, seed, spread):
    """Any symmetric positive definite matrix, condition up to 1e6: errors of its size times 1e-16."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    A = (Q * 10.0 ** rng.uniform(-spread, spread, n)) @ Q.T
    A, b = 0.5 * (A + A.T), rng.normal(size=n)
    lower, inverse = factors = factor_ldl(tuple(map(tuple, A.tolist())))
    L = np.eye(n)
    for i, row in enumerate(lower):
        L[i, :i] = row
    np.testing.assert_allclose(L @ np.diag(1.0 / np.array(inverse)) @ L.T, A, rtol=0, atol=1e-14 * np.abs(A).max() * n)
    assert (np.array(inverse) > 0.0).all()
    wanted = np.linalg.solve(A, b)
    found = solve_ldl(factors, tuple(b.tolist()))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.linalg.cond(A) * np.abs(wanted).max())


class Counted:
    """A scalar that is no constant and counts what is done to it."""

    done = 0

    def _operation(self, other=None):
        Counted.done += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __neg__ = _operation


def operations(of):
    x = Counted()
    Counted.done = 0
    at = arm.pose(of, (x,) * 4, SimpleNamespace(sin=lambda _: x, cos=lambda _: x))
    arm.dynamics(of, at, (x,) * 4)
    arm.tip(of, at)
    return Counted.done


def test_constants_of_the_geometry_cost_nothing():
    """Operations of dynamics and tip; the bound is what folding leaves, 5 % up.

    Were a 0 or 1 of the geometry to survive, each step of the loop would pay for it in every controller of a batch.
    """
    any_vector = (Counted(),) * 3
    unfolded = [link._replace(position=any_vector, rotation=(any_vector,) * 3) for link in CHAIN.links]
    assert operations(CHAIN) <= 908
    assert operations(CHAIN._replace(links=tuple(unfolded))) > 1800
