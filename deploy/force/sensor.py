"""What a force sensor is to the loop, and how its reading becomes the force on the tissue."""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, Protocol

from deploy.errors import CalibrationError
from deploy.puck.frame import Frame
from jaxmpc.law.scalar import Matrix, sub
from jaxmpc.law.vectors import Vector3

SATURATED: Final = 0x3F
BAD_DATA: Final = 0x40
TARE_AGAIN: Final = 0x80
IDENTITY: Final[Matrix] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Wrench(NamedTuple):
    """One reading: force [N], moment [N m], flags (`SATURATED` gauges or axes, `BAD_DATA`, `TARE_AGAIN`)."""

    force: Vector3
    moment: Vector3
    flags: int


class ForceSensor(Protocol):
    """A sensor of which one reading is taken in every cycle."""

    @property
    def ready(self) -> bool:
        """Whether the reading of this cycle is complete, so that nothing more need be waited for."""
        ...

    def request(self) -> tuple[Frame, ...]:
        """Begin a cycle: what was read before is stale, and these frames ask for the next reading."""
        ...

    def feed(self, frame: Frame) -> bool:
        """Take a frame off the bus; False if it is none of the sensor's."""
        ...

    def read(self) -> Wrench | None:
        """The reading of this cycle, None while there is none."""
        ...

    def tare(self) -> tuple[Frame, ...]:
        """Call what it feels now zero; these frames tell it so."""
        ...


class Mounted:
    """A sensor between the flange and the tool: its reading as the force of the robot on the tissue.

        y = −R (f − bias)

    The sensor feels what the environment does to the tool, and y is what the robot does to the tissue
    (definitions.md). R takes the sensor's frame to the world's. Nothing subtracts the weight of the tool as it
    turns: tare in the posture of work.
    """

    def __init__(self, sensor: ForceSensor, rotation: Matrix = IDENTITY, bias: Sequence[float] = (0.0, 0.0, 0.0)):
        """Mount a sensor.

        Args:
            sensor: It.
            rotation: R (3, 3).
            bias: Force that it reads when nothing touches the tool, in its own frame (3,) [N].

        Raises:
            CalibrationError: R is no rotation, or the bias is not finite.
        """
        self.sensor = sensor
        self.turn(rotation)
        if len(bias) != 3 or not all(map(math.isfinite, bias)):
            raise CalibrationError(f"a force bias of {tuple(bias)} cannot be right: tare the sensor again")
        self._bias = tuple(map(float, bias))

    def turn(self, rotation: Matrix) -> None:
        """Mount it another way from now on, as for another posture.

        Raises:
            CalibrationError: It is no rotation: its columns are not orthonormal, or it mirrors.
        """
        rows = tuple(tuple(map(float, row)) for row in rotation)
        if [len(row) for row in rows] != [3, 3, 3] or not _is_rotation(rows):
            raise CalibrationError(f"the force sensor's rotation {rows} is none: give an orthonormal 3×3 matrix")
        self._minus_rotation = tuple(tuple(-value for value in row) for row in rows)

    @property
    def ready(self) -> bool:
        """As `ForceSensor`."""
        return self.sensor.ready

    def request(self) -> tuple[Frame, ...]:
        """As `ForceSensor`."""
        return self.sensor.request()

    def feed(self, frame: Frame) -> bool:
        """As `ForceSensor`."""
        return self.sensor.feed(frame)

    def read(self) -> Wrench | None:
        """The wrench on the tissue in the world's frame, about the sensor's origin."""
        wrench = self.sensor.read()
        if wrench is None:
            return None
        (fx, fy, fz), (bx, by, bz) = wrench.force, self._bias
        force = self._turned(fx - bx, fy - by, fz - bz)
        return Wrench(force, self._turned(*wrench.moment), wrench.flags)

    def tare(self) -> tuple[Frame, ...]:
        """As `ForceSensor`; the bias was of the old zero and is forgotten."""
        self._bias = (0.0, 0.0, 0.0)
        return self.sensor.tare()

    def _turned(self, x: float, y: float, z: float) -> Vector3:
        """−R (x, y, z), written out: it runs in every cycle."""
        (a, b, c), (d, e, f), (g, h, i) = self._minus_rotation
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def mean_force(wrenches: Iterable[Wrench]) -> Vector3:
    """The mean force of readings (3,) [N], as for a bias.

    Raises:
        CalibrationError: There is none, or one of them is not to be relied on.
    """
    taken = list(wrenches)
    if not taken or any(wrench.flags & (BAD_DATA | SATURATED) for wrench in taken):
        raise CalibrationError(
            "the force sensor gives no sound reading: check its cable, and that nothing presses on it"
        )
    x, y, z = (math.fsum(axis) / len(taken) for axis in zip(*(wrench.force for wrench in taken), strict=True))
    return x, y, z


def _is_rotation(rows: Matrix) -> bool:
    a, b, c = rows
    products = [sum(x * y for x, y in zip(p, q, strict=True)) for p in rows for q in rows]
    errors = [abs(value - wanted) for value, wanted in zip(products, [1, 0, 0, 0, 1, 0, 0, 0, 1], strict=True)]
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return all(error < 1e-6 for error in errors) and max(map(abs, sub(cross, c))) < 1e-6
