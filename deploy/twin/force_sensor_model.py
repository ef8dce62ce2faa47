"""The force sensor's mechanics: inertia and weight beyond it, low-pass, noise, resolution."""

import math

import numpy as np

from deploy.twin.settings import TwinSettings
from jaxmpc.law.measurement import lowpass_pole
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.vectors import Vector3
from jaxmpc.world import sensor

GRAVITY = 9.805
"""libbarrett's [m/s²]."""
_BLOCK = 256


class ForceSensorModel:
    """Turns the force on the tissue into the force read, in the world's axes [N]."""

    def __init__(self, settings: TwinSettings) -> None:
        pole = lowpass_pole(2.0 * math.pi * settings.lowpass_hz, 1e-3, FLOATS)
        self._sensor = sensor.SensorModel(pole, settings.lsb, settings.beyond_sensor)
        self._state = sensor.init(settings.beyond_sensor > 0.0, 0.0)
        self._noise, self._random = settings.noise, np.random.default_rng([settings.seed, 1])
        x, y, z = settings.bias
        # What lies beyond hangs on the sensor as if the tissue pulled the arm down: y = K_s d points up then.
        self._offset: Vector3 = (x, y, z + settings.beyond_sensor * GRAVITY)
        self._drawn: list[Vector3] = []

    def read(self, force: Vector3, velocity: Vector3) -> Vector3:
        """Force read at this sample.

        Args:
            force: On the tissue [N].
            velocity: Of the tip [m/s].
        """
        if not self._drawn:
            self._drawn = self._random.normal(0.0, self._noise, (_BLOCK, 3)).tolist()
        felt = (force[0] + self._offset[0], force[1] + self._offset[1], force[2] + self._offset[2])
        noise = self._drawn.pop()
        (x, y, z), self._state = sensor.read(self._sensor, self._state, felt, velocity, noise, 1e-3, FLOATS)
        return x, y, z
