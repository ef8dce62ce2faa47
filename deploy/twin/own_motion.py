"""A recording of the twin's own motion without contact, for `jaxmpc identify`: what a user would record on a robot.

    python -m deploy.twin.own_motion jaxmpc/examples/twin-motion.csv

Each joint follows sines of three frequencies of its own under a stiff proportional-derivative law; angles are those of
the encoders and torques those commanded, as a log of the real arm would have them.
"""

import sys
from pathlib import Path

import numpy as np

from deploy.twin.compiled import joint_angles, motor_angles
from deploy.twin.settings import TwinSettings
from deploy.twin.world import TICK, TwinPhysics
from jaxmpc.files.sealed import write_atomic
from jaxmpc.law.transmission import JOINT_TO_MOTOR
from jaxmpc.world.heart.motion import Motion

COLUMNS = "t,q1,q2,q3,q4,tau1,tau2,tau3,tau4"
SECONDS, EVERY = 16.0, 4
"""Length [s], and ticks from one row to the next."""
BEGINNING = 0.8
"""Time in which the motion begins [s]."""
CENTRE = np.array((0.0, -0.6, 0.0, 1.6))
"""Angles that the joints swing about, far from the heart [rad]."""
AMPLITUDES = np.array(((0.35, 0.12, 0.05), (0.25, 0.10, 0.04), (0.40, 0.12, 0.05), (0.35, 0.12, 0.05)))
"""Amplitudes of the sines of each joint [rad]."""
FREQUENCIES = np.array(((0.13, 0.61, 1.73), (0.17, 0.53, 1.57), (0.11, 0.71, 1.91), (0.19, 0.67, 1.39)))
"""Frequencies of those sines [Hz]."""
KP, KD = np.array((900.0, 1100.0, 500.0, 350.0)), np.array((30.0, 40.0, 12.0, 8.0))
"""Gains of the law that makes the joints follow [N m/rad] and [N m s/rad]."""
ENCODER = 2.0 * np.pi / 4096.0
"""A count of the motors' encoders [rad]."""


def settings() -> TwinSettings:
    """Settings of the twin that moves: the nominal one with links 8 % heavier than the model, and a heart at rest."""
    return TwinSettings(motion=Motion(kind="none"), mass_scale=1.08)


def own_motion(seconds: float = SECONDS) -> np.ndarray:
    """Time [s], four joint angles [rad] and four joint torques [N m], a row for every fourth millisecond.

    Args:
        seconds: How long the arm moves [s].

    Raises:
        RuntimeError: The arm touched the heart.
    """
    physics = TwinPhysics(settings())
    physics.place(tuple(CENTRE.tolist()))
    to_motor: np.ndarray = np.linalg.inv(np.array(JOINT_TO_MOTOR).T)
    omega, rows = 2.0 * np.pi * FREQUENCIES, []
    for k in range(round(seconds / TICK)):
        t, truth = k * TICK, physics.truth()
        if truth.touching:
            raise RuntimeError(f"the arm touched the heart at {t:g} s")
        begun = min(t / BEGINNING, 1.0)
        wanted = CENTRE + begun * (AMPLITUDES * np.sin(omega * t)).sum(axis=1)
        speed = begun * (AMPLITUDES * omega * np.cos(omega * t)).sum(axis=1)
        torque = KP * (wanted - truth.q) + KD * (speed - truth.qd)
        counts = tuple(float(ENCODER * np.round(angle / ENCODER)) for angle in motor_angles(truth.q))
        if k % EVERY == 0:
            rows.append((t, *joint_angles(counts), *truth.torque))
        physics.advance(tuple((to_motor @ torque).tolist()), (False,) * 4)
    return np.array(rows)


def write(path: Path) -> None:
    """Write it as CSV."""
    lines = [
        ",".join((f"{row[0]:.3f}", *(f"{x:.5f}" for x in row[1:5]), *(f"{x:.3f}" for x in row[5:])))
        for row in own_motion()
    ]
    write_atomic(path, ("\n".join([COLUMNS, *lines]) + "\n").encode())


if __name__ == "__main__":
    write(Path(sys.argv[1]))
