"""Readings of encoders and force sensor at a millisecond, with the faults of these sensors."""

from collections.abc import Sequence

import numpy as np

from deploy.twin.compiled import motor_angles
from deploy.twin.faults import ENCODERS, Distortion, Fault
from deploy.twin.force_torque import ForceTorque
from deploy.twin.pucks import Puck
from jaxmpc.law.vectors import Vector3, Vector4


class Readings:
    """Samples the sensors once a millisecond.

    Attributes:
        counts: Count of each motor's encoder since the factory's zero; None where a fault leaves none.
        force: Tared force on the tissue (3,) [N]; None where a fault leaves none.
    """

    def __init__(
        self,
        pucks: Sequence[Puck],
        sensor: ForceTorque,
        faults: Sequence[Fault],
        random: Sequence[np.random.Generator],
    ) -> None:
        """Connect the sensors.

        Args:
            pucks: Four motor pucks.
            sensor: Force/torque sensor.
            faults: Faults of the twin, of which those of sensors count.
            random: Generators for the faults of four encoders and of the force.
        """
        self._pucks, self._sensor = pucks, sensor
        *encoders, force = random
        self._encoders = [Distortion(name, faults, each) for name, each in zip(ENCODERS, encoders, strict=True)]
        self._force_faults = Distortion("force", faults, force)
        self.counts: list[int | None] = [None] * 4
        self.force: Vector3 | None = None

    def sample(self, q: Vector4, force: Vector3, tick: int) -> None:
        """Read all sensors.

        Args:
            q: Joint angles [rad].
            force: Force on the tissue at the sensor, in the world's axes [N].
            tick: Milliseconds since the twin was switched on.
        """
        raw = [puck.turned(angle) for puck, angle in zip(self._pucks, motor_angles(q), strict=True)]
        self.counts = list(raw)
        for i, faults in enumerate(self._encoders):
            if faults:
                read = faults.read(tick, (float(raw[i]),))
                self.counts[i] = None if read is None else round(read[0])
        self._sensor.advance(force, 1e-3 * tick)
        self.force = self._sensor.tared(force)
        if self._force_faults:
            self.force = self._force_faults.read(tick, self.force)  # type: ignore[assignment]  # three as before
