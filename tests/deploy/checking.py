"""What the tests of the checker ask it, at a posture of work; the checker's module comes as an argument."""

from dataclasses import replace

from deploy.controller.limits import Limits
from deploy.puck.frame import Frame
from deploy.safety.kinematics import kinematics

T_S = 2.0**-10  # so that rate · T_s is exact
IPNM, PIDX = (2472, 2562, 2700, 2755), (2, 4, 1, 3)
POSTURE, REST, PUSH = (0.1, 0.7, -0.2, 2.2), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, -5.0)
MOTION = kinematics(0.36)
LIMITS = replace(
    Limits.default(MOTION(POSTURE, REST).tip), torque_rate=(12000.0,) * 4, motor_torque=(1.8, 1.8, 1.8, 1.6)
)
WIDE = replace(
    LIMITS,
    joint_torque=(75.6, 101.7, 60.53, 28.8),
    workspace=((-1, 1),) * 3,
    joint_range=((-2.6, 2.6), (-2.0, 2.0), (-2.8, 2.8), (-0.9, 3.15)),
    joint_velocity=(2.5,) * 4,
    tip_velocity=1.0,
    least_singular_value=0.02,
)


def frame_of(units, pidx=PIDX):
    """A packed torque by text: the units of motors 1–4 as 14 binary digits each, in the places of PIDX."""
    digits = [""] * 4
    for value, place in zip(units, pidx, strict=True):
        digits[place - 1] = format(value % 2**14, "014b")
    return Frame(0x401, bytes([0xAA]) + int("".join(digits), 2).to_bytes(7, "big"))


def make(checker, limits=LIMITS, pidx=PIDX):
    return checker.Checker(limits, T_S, IPNM, pidx, 0.36)


def asked(made, checker, units=(0, 0, 0, 0), how="control", q=POSTURE, qd=REST, force=PUSH, age=0, drive=True):
    return made.check(frame_of(units), drive, checker.Strictness(how), q, qd, force, age)
