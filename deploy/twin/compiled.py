"""The simulator's sources that the twin runs each millisecond, recorded once as straight-line functions."""

from collections.abc import Callable
from functools import cache
from typing import Any

from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc.law.scalar import apply, apply_transposed
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.law.vectors import Vector4
from jaxmpc.world import friction

_FOUR = (0.0, 0.0, 0.0, 0.0)

motor_angles = compile_straightline(lambda q: apply(JOINT_TO_MOTOR, q), (_FOUR,)).function
"""Motor angles from joint angles, or velocities from velocities."""
joint_angles = compile_straightline(lambda theta: apply(MOTOR_TO_JOINT, theta), (_FOUR,)).function
"""Joint angles from motor angles."""
joint_torques = compile_straightline(lambda torque: apply_transposed(JOINT_TO_MOTOR, torque), (_FOUR,)).function
"""Joint torques from motor torques."""


@cache
def friction_step(joints: friction.Friction, h: float) -> Callable[[Vector4, Vector4], Any]:
    """`jaxmpc.world.friction.step` over h [s] as a function of deflections [-] and joint velocities [rad/s]."""
    return compile_straightline(lambda s, v: friction.step(joints, s, v, h, OPS), (_FOUR, _FOUR)).function
