"""A motor that is pushed and does not move: its encoder stands still, or something holds it.

A servo that withdraws the tip pushes a joint until it moves. Where the encoder tells no motion it pushes ever harder,
and the joint swings unseen, at radians per second. In contact that is no danger, and nothing tells it: the force holds
the loop up without the encoder, and joints stand still for friction.

    |Bᵀ r| > 3 |B|ᵀ F + |Bᵀ Jᵀ y|

for a motor that stands still; r is all that disturbs the joints by their momentum, Jᵀy what the force that is read
makes of it (`deploy.safety.force_estimate`), F their usual friction, and B takes motor angles to joint angles. Signs do
not count: a reading that lies must not push a motor that nothing pushes.
"""

from collections.abc import Sequence

from deploy.durations import cycles
from deploy.runtime.straightline import compile_straightline
from deploy.safety.force_estimate import FRICTION
from deploy.safety.plausible import STUCK
from jaxmpc.law.scalar import apply_transposed
from jaxmpc.law.transmission import MOTOR_TO_JOINT
from jaxmpc.law.vectors import Vector4

FRICTIONS = 3.0
"""How often the usual friction no joint bears without a motion: healthy motors came to 0.67 of the bound, with twice
the friction and a tenth more mass to 0.73, and with twice the friction and a tool 0.3 kg heavier than its model to
0.98."""
LEFT: Vector4 = (0.3, 0.1, 0.1, 0.3)
"""Time for which a motor stands still on the way out before it counts where no force is believed [s]: 2 and 3 lift the
tip and move within 25 ms, 1 and 4 may have to wait until it has left the tissue."""
_NONE: Vector4 = (0.0, 0.0, 0.0, 0.0)
_SIZES = tuple(tuple(map(abs, row)) for row in MOTOR_TO_JOINT)
_FRICTION = apply_transposed(_SIZES, FRICTION)
_of_motors = compile_straightline(lambda torque: apply_transposed(MOTOR_TO_JOINT, torque), (_NONE,)).function


def unmoved(still: Sequence[int], disturbance: Vector4, read: Vector4 | None, withdrawing: int, T_s: float) -> int:
    """The first motor (0–3) that is pushed beyond friction and stands still, −1 if there is none.

    Args:
        still: Samples in a row in which each motor's encoder has told the same, less one.
        disturbance: Torque that the joints' motion leaves over [N m].
        read: What the force that is read makes of it [N m]; None where no sensor tells one that is believed.
        withdrawing: Samples since the tip began to withdraw, or was held after it.
        T_s: Sampling time [s].
    """
    for i, (samples, share) in enumerate(zip(still, shares(disturbance, read), strict=True)):
        least = STUCK - 1
        if read is None:
            samples, least = min(samples, withdrawing), cycles(LEFT[i], T_s)
        if samples >= least and not share <= 1.0:
            return i
    return -1


def shares(disturbance: Vector4, read: Vector4 | None) -> tuple[float, ...]:
    """How much of what it bears without a motion pushes each motor (4,) [-]; the arguments are those of `unmoved`."""
    each = zip(_of_motors(disturbance), _of_motors(read or _NONE), _FRICTION, strict=True)
    return tuple(abs(torque) / (FRICTIONS * friction + abs(told)) for torque, told, friction in each)
