"""The Barrett force/torque sensor, node 8: tare, axes, overload, int16 frames."""

import numpy as np

from deploy.twin.device import READY, Device
from deploy.twin.settings import TwinSettings
from jaxmpc.law.vectors import Vector3

VERSION = 24
ROLE = 6
TARING = 0x7F
"""ERROR while a tare runs."""
BAD = 0x40
"""Flag of the force's seventh byte: not to be used now."""
LARGEST = 127.99
"""Force at which an axis' int16 ends [N]."""


class ForceTorque(Device):
    """Force/torque sensor as the bus sees it."""

    def __init__(self, settings: TwinSettings) -> None:
        values = {"FT": 0, "A": 0, "GRPA": 10, "GRPB": 10, "GRPC": 10, "TEMP": 30}
        super().__init__(8, "force", VERSION, ROLE, values, not settings.cold)
        self._mount, self._turns = np.array(settings.mount), settings.frame == "tool"
        self._seconds, self._until = settings.tare_s, -1.0
        self._offset: Vector3 = (0.0, 0.0, 0.0)
        self._sum, self._samples = np.zeros(3), 0

    def set(self, prop: int, value: int, now: float) -> None:
        """As `Device.set`; FT = 0 tares."""
        if prop == self.number["FT"] and self.stat == READY:
            self._until, self._sum, self._samples = now + self._seconds, np.zeros(3), 0
            self.values[self.number["ERROR"]] = TARING
        else:
            super().set(prop, value, now)

    def advance(self, measured: Vector3, now: float) -> None:
        """Take a sample of the force on the tissue [N], which a running tare averages."""
        if self.values[self.number["ERROR"]] != TARING:
            return
        self._sum, self._samples = self._sum + measured, self._samples + 1
        if now >= self._until:
            x, y, z = (self._sum / self._samples).tolist()
            self._offset, self.values[self.number["ERROR"]] = (x, y, z), 0

    def tared(self, measured: Vector3) -> Vector3:
        """Force on the tissue less what was tared [N]."""
        return (measured[0] - self._offset[0], measured[1] - self._offset[1], measured[2] - self._offset[2])

    def reading(self, force: Vector3, orientation: np.ndarray) -> tuple[Vector3, int]:
        """Force of the surroundings on the sensor, −y in its own axes [N], and its flags.

        Args:
            force: On the tissue, tared, in the world's axes [N].
            orientation: From the tool's axes to the world's, shape (3, 3).
        """
        if self.values[self.number["ERROR"]] == TARING:
            return (0.0, 0.0, 0.0), BAD
        x, y, z = self.turned(-np.array(force), orientation)
        return (x, y, z), BAD if max(abs(x), abs(y), abs(z)) >= LARGEST else 0

    def turned(self, vector: np.ndarray, orientation: np.ndarray) -> Vector3:
        """A vector in the world's axes, shape (3,), in the sensor's."""
        axes = orientation @ self._mount if self._turns else self._mount
        x, y, z = (vector @ axes).tolist()
        return x, y, z
