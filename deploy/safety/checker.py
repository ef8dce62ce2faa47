"""The last word before the bus: every outgoing frame is decoded again and refused if it breaks a limit.

Nothing here comes from the controller, the codec or the clamp: the decoding, the transmission and the kinematics are
the checker's own, so that one mistake does not pass twice.
"""

from collections.abc import Sequence
from enum import StrEnum
from math import isfinite, sqrt

from deploy.controller.limits import Limits
from deploy.puck.frame import Frame
from deploy.safety.kinematics import kinematics
from deploy.safety.reasons import Reason
from jaxmpc.files.errors import InputError
from jaxmpc.law.vectors import Vector3, Vector4

PACKED, TORQUE, WIDTH = 0x401, 42, 14
"""Identifier of the packed torque, its property in newer firmware, bits of a value (wam.md §3.1–3.3)."""
CONTROL_AGE, HOLD_AGE = 2, 0.02
"""Oldest positions on which to control [cycles], and on which to hold the arm [s]."""
MODE, FORCE_TARE = 8, 54
SENSOR, SAFETY_MODULE, ALL_PUCKS, WAM = 8, 10, 0x400, 0x404


class Strictness(StrEnum):
    """Purpose of a torque frame, and with it the checks that it must pass."""

    CONTROL = "control"
    """The law drives: everything is checked."""
    SAFE = "safe"
    """The arm is braked, held or withdrawn: torques, their rate, and that angles are finite and at most 20 ms old.
    Where the arm is, how fast, and the force refuse nothing: it could not be held where a limit was left."""
    OFF = "off"
    """Nothing drives: only zero torque passes, from any torque at once."""


class Checker:
    """Refuses torque frames that break a limit; knows the last frame that it let pass.

    Attributes:
        torque: Joint torques of that frame [N m]: what acts on the arm now.
    """

    def __init__(
        self,
        limits: Limits,
        T_s: float,
        ipnm: Sequence[float],
        pidx: Sequence[int],
        tool_length: float,
        torque_property: int = TORQUE,
    ) -> None:
        """Check what the pucks said, once before motion.

        Args:
            limits: What may not be exceeded.
            T_s: Time between two frames [s].
            ipnm: Units per motor torque of motors 1–4, as read (4,) [1/(N m)].
            pidx: Place of motors 1–4 in the frame, from 1, as read (4,).
            tool_length: From the elbow's frame to the tip [m].
            torque_property: By which the pucks' firmware knows torque; older ones have another.

        Raises:
            InputError: Pucks that answer so are set up wrongly, or there is no such rate or tool.
        """
        for motor, units in enumerate(ipnm, 1):
            if not 2000 <= units <= 3500:
                raise InputError(f"IPNM of puck {motor}", units, "in [2000, 3500]", "Known arms have 2472 to 2755.")
        if len(ipnm) != 4 or sorted(pidx) != [1, 2, 3, 4]:
            raise InputError("PIDX of the pucks", tuple(pidx), "1, 2, 3 and 4, each once", "Set the pucks up again.")
        if not 1e-4 <= T_s <= 0.1:
            raise InputError("T_s", T_s, "in [1e-4, 0.1] s", "The paper's controller runs at 1e-3.")
        self.limits = limits
        self.torque: Vector4 = (0.0, 0.0, 0.0, 0.0)
        self._lsb = tuple(1.0 / units for units in ipnm)
        self._shift = tuple(WIDTH * (4 - place) for place in pidx)
        self._hold_age = max(round(HOLD_AGE / T_s), CONTROL_AGE)
        self._step = tuple(rate * T_s for rate in limits.torque_rate)
        self._motion = kinematics(tool_length)
        self._first = 0x80 | torque_property

    def check(
        self,
        frame: Frame,
        may_drive: bool,
        strictness: Strictness,
        q: Vector4,
        qd: Vector4,
        force: Vector3 | None,
        position_age: int,
    ) -> Reason | None:
        """Reason to refuse a torque frame, or None; then it counts as sent.

        Args:
            frame: Frame about to be sent.
            may_drive: Whether the pendant has activated the pucks and nothing forbids torque.
            strictness: Purpose of the frame.
            q: Joint angles [rad].
            qd: Joint velocities [rad/s].
            force: Measured force on the tissue [N]; None in a cycle without one.
            position_age: Age of the oldest position [cycles].
        """
        motors = self._decoded(frame)
        if motors is None:
            return Reason.FRAME
        if not may_drive or strictness not in (Strictness.CONTROL, Strictness.SAFE):
            if any(motors):
                return Reason.STATE
            self.torque = (0.0, 0.0, 0.0, 0.0)
            return None
        m1, m2, m3, m4 = motors
        torque = (-42.0 * m1, 28.25 * m2 - 28.25 * m3, -16.8155 * m2 - 16.8155 * m3, -18.0 * m4)
        reason = self._torque_reason(motors, torque)
        if reason is None:
            reason = self._position_reason(strictness, q, qd, position_age)
        if reason is None and strictness is Strictness.CONTROL:
            reason = self._motion_reason(q, qd) or self._force_reason(force)
        if reason is None:
            self.torque = torque
        return reason

    def _decoded(self, frame: Frame) -> Vector4 | None:
        """Motor torques 1–4 of a packed torque [N m]; None if it is none."""
        if frame.id != PACKED or len(frame.data) != 8 or frame.data[0] != self._first:
            return None
        bits = int.from_bytes(frame.data[1:], "big")
        motors = []
        for shift, lsb in zip(self._shift, self._lsb, strict=True):
            value = bits >> shift & 0x3FFF
            motors.append((value - 0x4000 if value > 0x1FFF else value) * lsb)
        return motors[0], motors[1], motors[2], motors[3]

    def _torque_reason(self, motors: Vector4, torque: Vector4) -> Reason | None:
        limits = self.limits
        for value, most in zip(motors, limits.motor_torque, strict=True):
            if not -most <= value <= most:
                return Reason.MOTOR_TORQUE
        for value, most, last, step in zip(torque, limits.joint_torque, self.torque, self._step, strict=True):
            if not -most <= value <= most:
                return Reason.JOINT_TORQUE
            if not -step <= value - last <= step:
                return Reason.TORQUE_RATE
        return None

    def _position_reason(self, strictness: Strictness, q: Vector4, qd: Vector4, position_age: int) -> Reason | None:
        if not 0 <= position_age <= self._hold_age:
            return Reason.POSITION_LOST
        if strictness is Strictness.CONTROL and position_age > CONTROL_AGE:
            return Reason.POSITION_OLD
        return None if all(map(isfinite, q)) and all(map(isfinite, qd)) else Reason.NOT_FINITE

    def _motion_reason(self, q: Vector4, qd: Vector4) -> Reason | None:
        limits = self.limits
        for angle, (low, high) in zip(q, limits.joint_range, strict=True):
            if not low <= angle <= high:
                return Reason.JOINT_RANGE
        for velocity, most in zip(qd, limits.joint_velocity, strict=True):
            if not -most <= velocity <= most:
                return Reason.JOINT_VELOCITY
        tip, tip_speed, elbow_speed, singular_value = self._motion(q, qd)
        for place, (low, high) in zip(tip, limits.workspace, strict=True):
            if not low <= place <= high:
                return Reason.WORKSPACE
        if not tip_speed <= limits.tip_velocity:
            return Reason.TIP_VELOCITY
        if not elbow_speed <= limits.tip_velocity:
            return Reason.ELBOW_VELOCITY
        return None if singular_value >= limits.least_singular_value else Reason.SINGULARITY

    def _force_reason(self, force: Vector3 | None) -> Reason | None:
        if force is None:
            return None
        x, y, z = force
        square = x * x + y * y + z * z
        if not isfinite(square):
            return Reason.FORCE_NOT_FINITE
        return None if sqrt(square) <= self.limits.force else Reason.FORCE


def check_service(frame: Frame) -> Reason | None:
    """Reason to refuse any other frame in motion, or None.

    Allowed are questions, the tare of the force sensor, and what lowers the arm's state: nothing that raises it, and
    no torque.
    """
    if not (0 < frame.id <= 31 or ALL_PUCKS <= frame.id <= ALL_PUCKS + 31):
        return Reason.FRAME
    if len(frame.data) == 1 and frame.data[0] < 0x80:
        return None
    if len(frame.data) not in (4, 6) or frame.data[0] < 0x80 or frame.data[1] != 0:
        return Reason.FRAME
    what = (frame.id, frame.data[0] & 0x7F, int.from_bytes(frame.data[2:], "little"))
    return None if what in _ALLOWED else Reason.STATE


_ALLOWED = {
    (ALL_PUCKS, MODE, 0),
    (WAM, MODE, 0),
    *((puck, MODE, 0) for puck in (1, 2, 3, 4)),
    (SAFETY_MODULE, MODE, 0),
    (SAFETY_MODULE, MODE, 1),
    (SENSOR, FORCE_TARE, 0),
}
