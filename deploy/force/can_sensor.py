"""Barrett's force/torque sensor on the arm's own bus (wam.md §4.1)."""

from typing import Final

from deploy.durations import cycles
from deploy.force.sensor import Wrench
from deploy.puck.codec import FORCE_READING, GROUPS, SENSOR, decode, get, set_value
from deploy.puck.frame import Frame
from deploy.puck.messages import ForceReply, MomentReply
from jaxmpc.law.vectors import Vector3

FORCE_ID: Final = GROUPS["force"] | SENSOR << 5
MOMENT_ID: Final = GROUPS["moment"] | SENSOR << 5
LOWPASS_HZ: Final = 227.0
"""Its own low-pass, of firmware 24 [Hz]."""
DOUBT: Final = 0.02
"""Time after a missing answer in which it may still come [s]."""


class CanSensor:
    """Asks once a cycle; the answer is two frames.

    Frames do not say which question they answer. After a missing answer the next cycles therefore wait for a
    second one until their time is up; two different ones in a cycle count as none, since either may be the late one.

    Attributes:
        malformed: Frames with its identifiers and a wrong length.
        doubtful: Cycles in which two different forces came.
    """

    def __init__(self, reading: int = FORCE_READING, T_s: float = 1e-3) -> None:
        """A sensor at node 8.

        Args:
            reading: Number of its property FT.
            T_s: Time between two questions [s].
        """
        self.malformed = self.doubtful = 0
        self._doubtful = cycles(DOUBT, T_s)
        self._request = (get(SENSOR, reading),)
        self._tare = (set_value(SENSOR, reading, 0),)
        self._force: ForceReply | None = None
        self._moment: Vector3 = (0.0, 0.0, 0.0)
        self._moment_came, self._forces, self._doubt = False, 1, 0  # nothing is missing before the first question

    @property
    def ready(self) -> bool:
        """Whether force and moment of this cycle are here, and no late one is to be reckoned with."""
        return self._forces > 1 or (self._forces == 1 and self._moment_came and not self._doubt)

    def request(self) -> tuple[Frame, ...]:
        """The question for a reading; one that is still missing is from now on late."""
        self._doubt = max(self._doubt - 1, 0) if self._forces else self._doubtful
        self._force, self._moment_came, self._forces = None, False, 0
        return self._request

    def feed(self, frame: Frame) -> bool:
        """Take force, moment, or nothing from a frame."""
        if frame.id != FORCE_ID and frame.id != MOMENT_ID:
            return False
        reply = decode(frame)
        if isinstance(reply, ForceReply):
            self._forces += 1
            if self._forces == 1:
                self._force = reply
            elif self._force != reply:
                self.doubtful += self._force is not None
                self._force, self._doubt = None, 0
        elif isinstance(reply, MomentReply):
            self._moment, self._moment_came = reply.moment, True
        else:
            self.malformed += 1
        return True

    def read(self) -> Wrench | None:
        """This cycle's force, with its moment or, if that frame is lost, the last one."""
        if self._force is None:
            return None
        return Wrench(self._force.force, self._moment, self._force.flags or 0)

    def tare(self) -> tuple[Frame, ...]:
        """The order to call the present load zero; the sensor takes about 1 s and reads 0 meanwhile."""
        return self._tare
