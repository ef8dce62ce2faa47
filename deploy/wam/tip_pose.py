"""Position and velocity of the tip and orientation of the tool, from the controller's own chain.

The tool's axes are those of the forearm: z along it, y the elbow's axis. With the angles of libbarrett's table

    R = Rz(q₁) Ry(q₂) Rz(q₃) Ry(q₄)
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc.law.chain import Chain, pose
from jaxmpc.law.chain import tip as chain_tip
from jaxmpc.law.scalar import apply, matmul
from jaxmpc.law.vectors import Vector3, Vector4


class TipKinematics(NamedTuple):
    """Place and velocity of the tip at a sample, in the shoulder's frame."""

    tip: Vector3
    """[m]"""
    velocity: Vector3
    """Velocity of the tip [m/s]."""
    axes: tuple[Vector3, Vector3, Vector3]
    """Rotation from the tool's axes, rows."""

    def turned(self, force: Vector3) -> Vector3:
        """A force in the tool's axes, in those of the shoulder [N]."""
        x, y, z = force
        (a, b, c), (d, e, f), (g, h, i) = self.axes
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def tip_kinematics(chain: Chain) -> Callable[[Vector4, Vector4], TipKinematics]:
    """A function of joint angles [rad] and velocities [rad/s].

    Args:
        chain: The arm.
    """

    def motion(q: Any, qd: Any) -> Any:
        at_tip = chain_tip(chain, pose(chain, q, OPS))
        return at_tip.position, apply(at_tip.jacobian, qd), tool_axes(q, OPS)

    run = compile_straightline(motion, ((0.0,) * 4, (0.0,) * 4)).function
    return lambda q, qd: TipKinematics(*run(q, qd))


def tool_axes(q: Any, ops: Any) -> Any:
    """Rotation R above from the tool's axes; `ops` has `sin` and `cos`."""
    turned: Any = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for i, angle in enumerate(q):
        s, c = ops.sin(angle), ops.cos(angle)
        about_z = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))
        about_y = ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))
        turned = matmul(turned, about_y if i % 2 else about_z)
    return turned
