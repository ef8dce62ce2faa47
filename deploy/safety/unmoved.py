"""A motor that is pushed and does not move: its encoder stands still, or something holds it.

A servo that withdraws the tip pushes a joint until it moves. Where the encoder tells no motion it pushes ever harder,
and the joint swings unseen, at radians per second. In contact that is no danger, and nothing tells it: the force holds
the loop up without the encoder, and joints stand still for friction.

    |Bᵀ r| > 3 |B|ᵀ F + |B|ᵀ l |y|

for a motor that stands still; r is all that disturbs the joints by their momentum (`deploy.safety.force_estimate`), F
their usual friction, l how far from each joint the tissue's push y may act, and B takes motor angles to joint angles.
"""

from collections.abc import Sequence

from deploy.durations import cycles
from deploy.safety.force_estimate import FRICTION
from deploy.safety.plausible import STUCK
from jaxmpc.law.scalar import apply_transposed
from jaxmpc.law.transmission import MOTOR_TO_JOINT
from jaxmpc.law.vectors import Vector4

FRICTIONS = 3.0
"""How often the usual friction no joint bears without a motion: 0.7 times were seen of usual joints, and a stuck
encoder comes to 3.6 to 8."""
LEFT: Vector4 = (0.3, 0.1, 0.1, 0.3)
"""Time for which a motor stands still on the way out before it counts where no force is believed [s]: 2 and 3 lift the
tip and move within 25 ms, 1 and 4 may have to wait until it has left the tissue."""
LEVERS: Vector4 = (0.6, 0.6, 0.3, 0.5)
"""Farthest from each joint's axis that the tip is where it touches a tissue [m]."""
_SIZES = tuple(tuple(map(abs, row)) for row in MOTOR_TO_JOINT)
_FRICTION = apply_transposed(_SIZES, FRICTION)
_LEVER = apply_transposed(_SIZES, LEVERS)


def unmoved(still: Sequence[int], disturbance: Vector4, push: float | None, withdrawing: int, T_s: float) -> int:
    """The first motor (0–3) that is pushed beyond friction and stands still, −1 if there is none.

    Args:
        still: Samples in a row in which each motor's encoder has told the same, less one.
        disturbance: Torque that the joints' motion leaves over [N m].
        push: Force on the tissue, of any direction [N]; None where no sensor tells it that is believed.
        withdrawing: Samples since the tip began to withdraw, or was held after it.
        T_s: Sampling time [s].
    """
    pushed = apply_transposed(MOTOR_TO_JOINT, disturbance)
    for i, (samples, torque) in enumerate(zip(still, pushed, strict=True)):
        least = STUCK - 1
        if push is None:
            samples, least = min(samples, withdrawing), cycles(LEFT[i], T_s)
        if samples >= least and not abs(torque) <= FRICTIONS * _FRICTION[i] + _LEVER[i] * (push or 0.0):
            return i
    return -1
