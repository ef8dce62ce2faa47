"""The torques that each task asks for: the recorded law in contact, a servo on the tip around it.

With x the tip, n the contact normal (from tissue to air) and x_d a reference that stands, or moves along n:

    a = −k_p e − k_i ∫e − k_d (ẋ − ẋ_d),   e = x − x_d

on the way out with k_f added along n for each newton that the tip presses beyond what it may still press, since a servo
is stiff: a beat that rises against it would press half as much again, or twice, before it gives way. That is made
torque by the same computed torque as in contact, so nothing jumps where one hands over to the other.
"""

import math
from dataclasses import dataclass
from typing import Any

from deploy.reference.sources import Source
from deploy.reference.stream import Stream
from deploy.runtime.arm import ArmRuntime
from deploy.safety.machine import Task
from jaxmpc.law.vectors import Vector3, Vector4

NONE: Vector3 = (0.0, 0.0, 0.0)

STIFFNESS, INTEGRAL, DAMPING = 900.0, 6750.0, 67.5
"""k_p [1/s²], k_i [1/s³], k_d [1/s]: poles near 22 rad/s, slow beside the sampling, fast beside what is asked for."""
LARGEST_ERROR = 0.02
"""Bound on e and on its integral's share in a [m]: a servo that is held back must not pull ever harder."""
YIELDING, LARGEST_PUSH = 4.0, 2.5
"""k_f [m/s² per N], and how much more push adds no more [N]: on 2 kN/m it gives way like a spring of 90 rad/s, and the
tip left −10 N at 0.18 m/s at most (docs/robot.md), of the 0.28 that end a run."""
SOFTER = 0.3
"""Share of the servo's bandwidth that is left after each swing [-]: its poles then bear three times the delay."""
LETTING_UP = 200.0
"""Rate at which the push that it may still press falls from that at the beginning to none [N/s]."""


@dataclass(frozen=True)
class Contacting:
    """Speeds, ways and forces of approach and retraction."""

    normal: Vector3 = (0.0, 0.0, 1.0)
    """From the tissue to the air, unit length, shoulder frame."""
    approach_speed: float = 0.005
    """[m/s]"""
    approach_limit: float = 0.06
    """Farthest way down without contact [m]."""
    threshold: float = 0.3
    """Force that is a contact [N]."""
    retract_speed: float = 0.05
    """[m/s]"""
    retract_distance: float = 0.03
    """[m]"""


class TaskController:
    """Wanted joint torques, cycle by cycle."""

    def __init__(
        self,
        runtime: ArmRuntime,
        source: Source,
        T_s: float,
        contacting: Contacting,
        ahead: int = 0,
        **stream: float,
    ) -> None:
        """Take the law and its force reference.

        Args:
            runtime: The recorded law.
            source: Wanted force on the tissue since contact.
            T_s: Sampling time [s].
            contacting: How the tissue is met and left.
            ahead: Samples of the wanted force that the law looks ahead; 0 for none.
            **stream: `rate` [N/s] and `largest` [N] of the wanted force.
        """
        self.runtime, self.contacting = runtime, contacting
        self.force_ref: Vector3 = NONE
        self._source, self._T_s = source, T_s
        self._limits: dict[str, Any] = {"ahead": ahead, **stream}
        self._stream: Stream | None = None
        self._samples = 0
        self._task = Task.OFF
        self._reference, self._start, self._sum = NONE, NONE, NONE
        self._allowed, self._bandwidth = 0.0, 1.0

    def torque(
        self,
        task: Task,
        q: Vector4,
        qd: Vector4,
        tip: Vector3,
        tip_velocity: Vector3,
        force: Vector3 | None,
        active: bool = True,
    ) -> Vector4:
        """Joint torques that a task asks for, before any clamp [N m].

        Args:
            task: Of this cycle.
            q: Joint angles [rad].
            qd: Joint velocities [rad/s].
            tip: Position of the tip [m].
            tip_velocity: [m/s]
            force: Measured force on the tissue [N]; None where there is none to trust.
            active: Whether the pucks follow. An arm that they do not hold yet may be moved by hand: where it is let go
                is where it is then held, without a leap back.
        """
        entered = task is not self._task
        self._task = task
        if task is Task.CONTROL:
            if entered:
                self._enter(force or NONE, q)
                self._start = tip
            return self._control(q, qd, force)
        if task is Task.OFF:
            return (0.0, 0.0, 0.0, 0.0)
        if task is Task.GRAVITY:
            held: Vector4 = self.runtime.gravity(q)
            return held
        if entered or (task is Task.HOLD and not active):
            self._reference, self._start, self._sum = tip, tip, NONE
        speed = {Task.APPROACH: -self.contacting.approach_speed, Task.RETRACT: self.contacting.retract_speed}.get(
            task, 0.0
        )
        if task is Task.RETRACT and self.travelled(tip):
            speed = 0.0
        away = self._yielding(entered, force or NONE) if task is Task.RETRACT else 0.0
        return self._servo(speed, away, q, qd, tip, tip_velocity, force or NONE)

    def travelled(self, tip: Vector3) -> bool:
        """Whether the approach or the retraction has gone as far as it may."""
        # The reference may be far ahead of an arm that something holds back.
        gone, asked = self.along(self._start, tip), self.along(self._start, self._reference)
        if self._task is Task.APPROACH:
            far = self.contacting.approach_limit
            return gone < -far or asked < -far - LARGEST_ERROR
        if self._task is Task.RETRACT:
            far = self.contacting.retract_distance
            return gone >= far or asked >= 2.0 * far
        return False

    def depth(self, tip: Vector3) -> float:
        """How far the tip has gone down since contact was made [m]; 0 without contact."""
        return -self.along(self._start, tip) if self._task is Task.CONTROL else 0.0

    def along(self, start: Vector3, end: Vector3) -> float:
        """Distance from one point to another along the contact normal [m]."""
        return sum(n * (b - a) for n, a, b in zip(self.contacting.normal, start, end, strict=True))

    def push(self, force: Vector3) -> float:
        """Push into the tissue of a force on it [N]."""
        return -self.along(NONE, force)

    def touching(self, force: Vector3 | None) -> bool:
        """Whether the force is that of a contact: a tissue that holds the tip may as well pull, or drag it aside."""
        return force is not None and math.hypot(*force) > self.contacting.threshold

    def soften(self) -> None:
        """The servo has swung a joint: from now on it has less bandwidth."""
        self._bandwidth *= SOFTER

    @property
    def contact_time(self) -> float:
        """Time for which the cascade has been in control [s]."""
        return self._samples * self._T_s

    def notes(self) -> list[str]:
        """Notes of the force reference's source."""
        return self._source.notes()

    def _enter(self, force: Vector3, q: Vector4) -> None:
        """Enter contact without a bump: observers start at the measured force, and so does the wanted one."""
        self.runtime.enter(force, q)
        self._stream = Stream(self._source, self._T_s, force, **self._limits)
        self._samples = 0

    def _control(self, q: Vector4, qd: Vector4, force: Vector3 | None) -> Vector4:
        assert self._stream is not None
        wanted: Any = self._stream.at(self.contact_time)
        self._samples += 1
        x, y, z = wanted
        self.force_ref = (x[0], y[0], z[0]) if isinstance(x, tuple) else wanted
        return self.runtime.control(q, qd, force, wanted)

    def _yielding(self, entered: bool, force: Vector3) -> float:
        """Acceleration away from the tissue for what the tip presses beyond what it may still press [m/s²]."""
        push = self.push(force)
        self._allowed = max(push if entered else self._allowed - LETTING_UP * self._T_s, 0.0)
        return YIELDING * min(max(push - self._allowed, 0.0), LARGEST_PUSH)

    def _servo(
        self, speed: float, away: float, q: Vector4, qd: Vector4, tip: Vector3, tip_velocity: Vector3, force: Vector3
    ) -> Vector4:
        step, share = speed * self._T_s, self._bandwidth
        normal = self.contacting.normal
        self._reference = _plus(self._reference, step, normal)
        error = _within(_plus(tip, -1.0, self._reference), LARGEST_ERROR)
        self._sum = _within(_plus(self._sum, self._T_s, error), LARGEST_ERROR * STIFFNESS / (share * INTEGRAL))
        velocity = _plus(tip_velocity, -speed, normal)
        a = _plus(_plus(NONE, -(share**2) * STIFFNESS, error), -(share**3) * INTEGRAL, self._sum)
        a = _plus(a, -share * DAMPING, velocity)
        a = _plus(a, away, normal)
        return self.runtime.servo(q, qd, a, force)


def _plus(a: Vector3, factor: float, b: Vector3) -> Vector3:
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def _within(a: Vector3, length: float) -> Vector3:
    size = math.hypot(*a)
    return a if size <= length else _plus(NONE, length / size, a)
