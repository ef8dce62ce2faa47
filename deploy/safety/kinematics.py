"""Kinematics of tip and elbow: the safety layer's own, apart from those of the controller.

The DH table of the 4-DoF WAM (wam.md §1.1), multiplied out by hand. Joints turn about z, y, z, y; with offsets
b = 0.045 m and the upper arm's length l = 0.55 m the tip lies, in the frame of the twisted upper arm, in its plane at

    a = b − b cos q₄ + d sin q₄,   h = l + b sin q₄ + d cos q₄          d the tool's length from the elbow's frame
    tip = Rz(q₁) Ry(q₂) Rz(q₃) (a, 0, h),   elbow = Rz(q₁) Ry(q₂) Rz(q₃) (b, 0, l)

Speeds and singular values do not change when everything turns about z, so they are found without Rz(q₁).
In common with the controller are this arm and the recorder that makes straight-line code of arithmetic; formulas and
constants are this file's own.
"""

from collections.abc import Callable
from functools import lru_cache
from math import acos, cos, pi, sqrt
from typing import Any, NamedTuple

from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc.files.errors import InputError
from jaxmpc.law.vectors import Vector3

OFFSET, UPPER_ARM = 0.045, 0.55
"""b and l above [m]."""

Vector = tuple[Any, ...]


class TipMotion(NamedTuple):
    """Motion of tip and elbow at an instant."""

    tip: Vector3
    """Place of the tip in the shoulder's frame [m]."""
    tip_speed: float
    """[m/s]"""
    elbow_speed: float
    """[m/s]"""
    least_singular_value: float
    """Least singular value of the tip's 3×4 Jacobian [m/rad]."""


def tool_length_checked(tool_length: Any) -> float:
    """A tool's length [m].

    Raises:
        InputError: It is not a number between the bare arm's 0.35 m and 0.6 m.
    """
    try:
        length = float(tool_length)
    except (TypeError, ValueError):
        length = 0.0
    if not 0.3 <= length <= 0.6:
        remedy = "Measure from the elbow's frame to the tip: 0.35 m without tool, 0.36 m to the tool plate."
        raise InputError("tool_length", tool_length, "in [0.3, 0.6] m", remedy)
    return length


def kinematics(tool_length: float) -> Callable[[Vector, Vector], TipMotion]:
    """A function of joint angles [rad] and velocities [rad/s], four floats each, all finite.

    Args:
        tool_length: From the elbow's frame to the tip, d above [m].

    Raises:
        InputError: No arm has such a tool.
    """
    run = _recorded(tool_length_checked(tool_length))

    def motion(q: Vector, qd: Vector) -> TipMotion:
        tip, tip_speed, elbow_speed, gram = run(q, qd)
        return TipMotion(tip, tip_speed, elbow_speed, sqrt(max(least_eigenvalue(gram), 0.0)))

    return motion


@lru_cache(maxsize=4)
def _recorded(length: float) -> Callable[[Vector, Vector], Any]:
    return compile_straightline(lambda q, qd: _motion(length, q, qd), ((0.0,) * 4, (0.0,) * 4)).function


def _motion(d: float, q: Vector, qd: Vector) -> Any:
    """Tip, its and the elbow's speed, and J Jᵀ: plain arithmetic, recorded."""
    s1, s2, s3, s4 = map(OPS.sin, q)
    c1, c2, c3, c4 = map(OPS.cos, q)

    def turned(x: Any, y: Any, z: Any) -> Vector:
        """Ry(q₂) Rz(q₃) (x, y, z)."""
        ahead, side = c3 * x - s3 * y, s3 * x + c3 * y
        return c2 * ahead + s2 * z, side, c2 * z - s2 * ahead

    def columns(x: Any, y: Any, z: Any, a: Any) -> list[Vector]:
        """Derivatives by q₁, q₂, q₃ of a point (x, y, z) that lies a beside the axis of the upper arm."""
        return [(-y, x, 0.0), (z, 0.0, -x), turned(0.0, a, 0.0)]

    a, h = OFFSET - OFFSET * c4 + d * s4, UPPER_ARM + OFFSET * s4 + d * c4
    x, y, z = turned(a, 0.0, h)
    # The derivative of (a, 0, h) by q₄ is (h − l, 0, b − a).
    jacobian = [*columns(x, y, z, a), turned(h - UPPER_ARM, 0.0, OFFSET - a)]
    x4, y4, z4 = turned(OFFSET, 0.0, UPPER_ARM)
    elbow = columns(x4, y4, z4, OFFSET)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    gram = tuple(sum(column[i] * column[j] for column in jacobian) for i, j in pairs)
    return (c1 * x - s1 * y, s1 * x + c1 * y, z), _speed(jacobian, qd), _speed(elbow, qd[:3]), gram


def _speed(jacobian: list[Vector], qd: Vector) -> Any:
    velocity = [sum(column[i] * rate for column, rate in zip(jacobian, qd, strict=True)) for i in range(3)]
    return OPS.sqrt(sum(each * each for each in velocity))


def least_eigenvalue(matrix: tuple[float, ...]) -> float:
    """Compute the least eigenvalue of a symmetric 3×3 matrix in closed form (Smith, Comm. ACM 4, 1961).

    Exact to about 1e-15 of the largest, to 1e-8 where the two least are equal.

    Args:
        matrix: Its entries 11, 22, 33, 12, 13, 23.
    """
    a, b, c, d, e, f = matrix
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    spread = sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if spread == 0.0:
        return mean
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (spread * spread * spread)
    # The three eigenvalues are mean + 2 spread cos(φ + 2πk/3), φ = arccos(half)/3; the least has k = 1.
    return mean + 2.0 * spread * cos((acos(min(max(half, -1.0), 1.0)) + 2.0 * pi) / 3.0)
