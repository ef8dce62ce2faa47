"""Contact of the tip with the heart: where it begins, what it holds on to, how it ends."""

import math

import numpy as np

from deploy.twin.settings import TwinSettings
from jaxmpc.experiment.tables import softening
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.vectors import Vector3
from jaxmpc.world import tissue

LIFTED = 10.0 * tissue.WIDTH
"""Height above the tissue at which a merely touching tip has left it [m]: the force is 1e-5 of what it was."""
RADIUS = 0.06
"""How far from where it is to be touched the heart's surface ends [m]."""
_LARGEST_FORCE = 1e3
"""Where the tissue's force is cut off, so that no fault can make numbers overflow [N]."""
_NONE: Vector3 = (0.0, 0.0, 0.0)


class TwinContact:
    """Contact of the tip with the tissue under it.

    Attributes:
        touching: Whether the tip is in contact.
    """

    def __init__(self, settings: TwinSettings, rest: Vector3) -> None:
        """Begin without contact.

        Args:
            settings: Of the twin.
            rest: Where the resting heart's surface is to be touched [m].
        """
        self._settings, self._pull_off, self._rest = settings.tissue, settings.pull_off, rest
        self._kind, self._attached = settings.tissue.kind, settings.tissue.attached
        self._constants = tissue.Tissue(settings.stiffness, settings.tissue.constants)
        self.begin(False)

    def begin(self, touching: bool) -> None:
        """Begin anew; a contact is then one without force where the heart rests."""
        self.touching, self._anchor = touching, self._rest
        self._memory = tissue.init(self._kind, self._attached, 0.0)

    def press(self, tip: Vector3, speed: Vector3, heart: Vector3, rate: Vector3, t: float, h: float) -> Vector3:
        """Force on the tissue now [N]; what the tissue remembers goes on by h [s], contact begins and ends.

        Args:
            tip: Its position [m].
            speed: Its velocity [m/s].
            heart: Displacement of the heart's surface [m].
            rate: Velocity of the heart's surface [m/s].
            t: Time [s].
            h: Time until the next call [s].
        """
        at = self._anchor
        x, y, z = tip[0] - heart[0] - at[0], tip[1] - heart[1] - at[1], tip[2] - heart[2] - at[2]
        above = self.touching or self._above(tip)
        if not self._attached:
            self.touching = above and z <= (2.0 * LIFTED if self.touching else LIFTED)
        elif not self.touching and above and z <= 0.0:
            # It sticks where it touches: no force along the surface yet.
            self.touching, self._anchor = True, (at[0] + x, at[1] + y, at[2])
            x = y = 0.0
        # A tissue that holds nothing still remembers, and where the tip will stick goes along with it.
        if not (self.touching or (above and not self._attached)):
            return _NONE
        constants = self._changed(t) if self._settings.changes else self._constants
        now = self._memory, (x, y, z), (speed[0] - rate[0], speed[1] - rate[1], speed[2] - rate[2])
        force = tissue.force(self._kind, self._attached, constants, *now, FLOATS)
        self._memory = tissue.relax(self._kind, self._attached, constants, *now, h, FLOATS)
        if self._attached and force[2] > self._pull_off:
            self.touching, self._memory = False, tissue.init(self._kind, True, 0.0)
            return _NONE
        if not self.touching:
            return _NONE
        return _cut(force[0]), _cut(force[1]), _cut(force[2])

    def _changed(self, t: float) -> tissue.Tissue:
        """Constants behind the changes of stiffness up to a time [s]."""
        factor = float(softening(self._settings, np.array([t]))[0])
        return self._constants._replace(stiffness=factor * self._constants.stiffness)

    def _above(self, tip: Vector3) -> bool:
        return math.hypot(tip[0] - self._rest[0], tip[1] - self._rest[1]) < RADIUS


def _cut(force: float) -> float:
    return min(max(force, -_LARGEST_FORCE), _LARGEST_FORCE)
