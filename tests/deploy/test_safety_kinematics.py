"""The module comes as an argument, so that the mutation test can hand in a wrong one."""

import math

import numpy as np
import pytest

from deploy.safety import kinematics as right
from jaxmpc.files.errors import InputError

REST = (0.0, 0.0, 0.0, 0.0)
HALF = math.pi / 2
# wam.md §1.4: joint angles, elbow axis, tool at d = 0.35 and 0.36 m
TABLE = [
    ((0.0, 0.0, 0.0, 0.0), (0, 0, 0.900), (0, 0, 0.910)),
    ((0.0, -2.0, 0.0, 3.13), (-0.22150, 0, 0.00207), (-0.21245, 0, 0.00633)),
    ((0.0, -1.99, 0.0, 3.14), (-0.21961, 0, 0.00128), (-0.21048, 0, 0.00537)),
    ((0.0, HALF, 0.0, 0.0), (0.900, 0, 0), (0.910, 0, 0)),
    ((HALF, HALF, 0.0, 0.0), (0, 0.900, 0), (0, 0.910, 0)),
    ((0.0, 0.0, 0.0, HALF), (0.395, 0, 0.595), (0.405, 0, 0.595)),
    ((0.3, -0.7, 0.5, 1.9), (-0.09986, 0.16520, 0.58760), (-0.09315, 0.17203, 0.59048)),
]
DH = ((0.0, -HALF, 0.0), (0.0, HALF, 0.0), (0.045, -HALF, 0.550), (-0.045, HALF, 0.0))


@pytest.fixture(scope="module")
def kinematics():
    return right


def frames(q, d):
    """Homogeneous transforms of frames 1–4 and of the tool, Rz(θ) Tz(d) Tx(a) Rx(α) each."""
    found, T = [], np.eye(4)
    for (a, alpha, offset), theta in zip((*DH, (0.0, 0.0, d)), (*q, 0.0), strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, offset], [0, 0, 0, 1]]
        T = T @ np.array(step)
        found.append(T)
    return found


def geometric(q, d):
    """Tip, and Jacobians of tip and elbow axis: columns z × (p − o), the textbook's way."""
    found = [np.eye(4), *frames(q, d)]
    tip, elbow = found[5][:3, 3], found[3][:3, 3]
    columns = [(found[i][:3, 2], found[i][:3, 3]) for i in range(4)]
    of_tip = np.array([np.cross(z, tip - o) for z, o in columns]).T
    of_elbow = np.array([np.cross(z, elbow - o) for z, o in columns[:3]]).T
    return tip, of_tip, of_elbow


def test_published_places_of_the_tool(kinematics):
    short, long = kinematics.kinematics(0.35), kinematics.kinematics(0.36)
    for q, at_035, at_036 in TABLE:
        # five decimals are published
        np.testing.assert_allclose(short(q, REST).tip, at_035, atol=6e-6)
        np.testing.assert_allclose(long(q, REST).tip, at_036, atol=6e-6)


def test_against_the_dh_product(kinematics):
    draw = np.random.default_rng(4)
    for _ in range(40):
        d, q, qd = draw.uniform(0.3, 0.6), draw.uniform(-3.0, 3.0, 4), draw.normal(size=4)
        tip, of_tip, of_elbow = geometric(q, d)
        found = kinematics.kinematics(d)(tuple(q.tolist()), tuple(qd.tolist()))
        # all are O(1) sums of a few products; the singular value is a root of a number known to 1e-15
        np.testing.assert_allclose(found.tip, tip, atol=1e-14)
        assert found.tip_speed == pytest.approx(np.linalg.norm(of_tip @ qd), abs=1e-13)
        assert found.elbow_speed == pytest.approx(np.linalg.norm(of_elbow @ qd[:3]), abs=1e-13)
        assert found.least_singular_value == pytest.approx(np.linalg.svd(of_tip)[1][2], abs=1e-7)


def test_the_oracle_by_differences():
    q, h = np.array([0.3, -0.7, 0.5, 1.9]), 1e-6
    _, of_tip, of_elbow = geometric(q, 0.36)
    steps = h * np.eye(4)
    by_tip = [(frames(q + s, 0.36)[4][:3, 3] - frames(q - s, 0.36)[4][:3, 3]) / (2 * h) for s in steps]
    by_elbow = [(frames(q + s, 0.36)[2][:3, 3] - frames(q - s, 0.36)[2][:3, 3]) / (2 * h) for s in steps[:3]]
    np.testing.assert_allclose(of_tip, np.transpose(by_tip), atol=1e-9)
    np.testing.assert_allclose(of_elbow, np.transpose(by_elbow), atol=1e-9)


def test_singular_poses(kinematics):
    motion = kinematics.kinematics(0.36)
    # straight up: no way sideways; stretched out: hardly any way along the arm, whose elbow is offset by 45 mm
    assert motion((0.0, 0.0, 0.0, 0.0), REST).least_singular_value < 1e-7
    assert 0.03 < motion((0.4, HALF, 0.3, 0.0), REST).least_singular_value < 0.05
    # where rounding makes the eigenvalue negative, the root is still a number
    for length in np.linspace(0.3, 0.6, 31):
        for q in ((0.3, 0.0, 0.2, 0.0), (0.1, 0.0, -2.2, 0.0), (2.0, 0.0, 1.0, 0.0)):
            assert 0.0 <= kinematics.kinematics(length)(q, REST).least_singular_value < 1e-7
    assert motion((0.0, 0.7, 0.0, 2.2), REST).least_singular_value > 0.3


def test_least_eigenvalue(kinematics):
    draw = np.random.default_rng(5)
    matrices = [M + M.T for M in draw.normal(size=(60, 3, 3))]
    matrices += [2.5 * np.eye(3), np.zeros((3, 3)), np.diag([1.0, 3.0, 3.0]), np.diag([3.0, 1.0, 1.0]), np.ones((3, 3))]
    for i, M in enumerate(matrices):
        entries = (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])
        found = kinematics.least_eigenvalue(tuple(map(float, entries)))
        # the arc cosine loses half the digits where the two least are equal, as in the last two
        assert found == pytest.approx(np.linalg.eigvalsh(M)[0], abs=1e-13 if i < len(matrices) - 2 else 3e-8)
    # turned, so that rounding takes the cosine beyond ±1
    for diagonal in ((1.0, 1.0, 3.0), (1.0, 3.0, 3.0)):
        for M in draw.normal(size=(200, 3, 3)):
            axes = np.linalg.qr(M)[0]
            M = axes @ np.diag(diagonal) @ axes.T
            entries = (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])
            assert kinematics.least_eigenvalue(tuple(map(float, entries))) == pytest.approx(1.0, abs=1e-7)


def test_tool_lengths(kinematics):
    for length in (0.3, 0.35, 0.6, "0.36", np.float64(0.4)):
        assert kinematics.tool_length_checked(length) == float(length)
    for length in (0.2999, 0.6001, math.nan, math.inf, -0.36, "long", None):
        with pytest.raises((InputError, TypeError), match="tool_length"):
            kinematics.kinematics(length)
