"""Properties of the motor pucks, and by them counts as joint angles, units as joint torques."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import floor, pi
from typing import Any, Final

from deploy.controller.least_rate import IPNM_RANGE
from deploy.errors import CalibrationError
from deploy.puck import properties
from deploy.puck.codec import LARGEST_TORQUE
from deploy.puck.messages import Units
from deploy.runtime.straightline import compile_straightline
from jaxmpc.law.scalar import apply, apply_transposed
from jaxmpc.law.transmission import JOINT_TO_MOTOR, MOTOR_TO_JOINT
from jaxmpc.law.vectors import Vector4

COUNTS_PER_TURN: Final = (4096, 40960)
"""Counts of a motor encoder's turn, magnetic and old optical ones (wam.md §2.6)."""


@dataclass(frozen=True)
class PuckInfo:
    """Properties of one motor puck, as read from it.

    Attributes:
        node: Its number on the bus.
        pidx: Its place in a packed torque, 1 to 4, which is the number of its motor.
        version: Of its firmware (VERS).
        role: Kind and encoders (ROLE).
        counts_per_turn: Of its encoder (CTS).
        units_per_torque: Torque units per N m of its motor (IPNM).
        largest_torque: Where it caps its torque itself [units] (MT).

    Raises:
        CalibrationError: A value that no working puck has.
    """

    node: int
    pidx: int
    version: int
    role: int
    counts_per_turn: int
    units_per_torque: int
    largest_torque: int

    def __post_init__(self) -> None:
        role = self.role & 0x1F
        if role != properties.ROLES.index("motor"):
            what = properties.ROLES[role] if role < len(properties.ROLES) else f"role {role}"
            raise CalibrationError(f"puck {self.node} is no motor puck but says {what}: check its ROLE with btutil")
        if self.counts_per_turn not in COUNTS_PER_TURN:
            known = " or ".join(map(str, COUNTS_PER_TURN))
            raise CalibrationError(
                f"puck {self.node} says CTS {self.counts_per_turn}, not {known}: check it with btutil"
            )
        low, high = IPNM_RANGE
        if not low <= self.units_per_torque <= high:
            said = f"puck {self.node} says IPNM {self.units_per_torque}, not {low} to {high}"
            raise CalibrationError(f"{said}: torques would be wrong, calibrate it with btutil")
        if not 0 < self.largest_torque <= LARGEST_TORQUE:
            said = f"puck {self.node} says MT {self.largest_torque}, not 1 to {LARGEST_TORQUE}"
            raise CalibrationError(f"{said}: it would give no torque or an unbounded one, set it with btutil")

    def number(self, name: str) -> int:
        """Number of a property in this puck's firmware."""
        return properties.number(name, "motor", self.version)


@dataclass(frozen=True)
class Pucks:
    """The four motor pucks, in the order of their PIDX.

    Joint angles are M θ and joint torques Tᵀ τ, with the motors' angles θ [rad] and torques τ [N m] and with T and M
    of `jaxmpc.world.drive`.

    Attributes:
        infos: One for each motor.

    Raises:
        CalibrationError: Their places are not 1 to 4, or their firmware does not go together.
    """

    infos: tuple[PuckInfo, ...]
    _angles: Callable[[Any], Vector4] = field(init=False, repr=False, compare=False)
    _units: Callable[[Any], Vector4] = field(init=False, repr=False, compare=False)
    _torque: Callable[[Any], Vector4] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        infos = tuple(sorted(self.infos, key=lambda info: info.pidx))
        if [info.pidx for info in infos] != [1, 2, 3, 4]:
            places = ", ".join(f"puck {info.node}: {info.pidx}" for info in self.infos)
            raise CalibrationError(f"the pucks' places in a torque are not 1 to 4 ({places}): set PIDX with btutil")
        for name in ("P", "T", "MODE"):
            if len({info.number(name) for info in infos}) > 1:
                versions = ", ".join(f"puck {info.node}: {info.version}" for info in infos)
                raise CalibrationError(f"the pucks' firmware differs in {name} ({versions}): have them updated alike")
        object.__setattr__(self, "infos", infos)
        per_count = [2.0 * pi / info.counts_per_turn for info in infos]
        ipnm = [float(info.units_per_torque) for info in infos]

        def angles(counts: Sequence[Any]) -> Any:
            return apply(MOTOR_TO_JOINT, tuple(n * each for n, each in zip(counts, per_count, strict=True)))

        def units(torque: Sequence[Any]) -> Any:
            motor = apply_transposed(MOTOR_TO_JOINT, tuple(torque))
            return tuple(each * scale for each, scale in zip(motor, ipnm, strict=True))

        def torque(units: Sequence[Any]) -> Any:
            return apply_transposed(JOINT_TO_MOTOR, tuple(n / scale for n, scale in zip(units, ipnm, strict=True)))

        for name, function in (("_angles", angles), ("_units", units), ("_torque", torque)):
            object.__setattr__(self, name, compile_straightline(function, ((0.0,) * 4,)).function)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node identifiers of the motors 1 to 4."""
        return tuple(info.node for info in self.infos)

    @property
    def ipnm(self) -> tuple[int, ...]:
        """Torque units per N m of the motors 1 to 4."""
        return tuple(info.units_per_torque for info in self.infos)

    @property
    def caps(self) -> tuple[float, ...]:
        """Torques at which the pucks of the motors 1 to 4 cut [N m]."""
        return tuple(info.largest_torque / info.units_per_torque for info in self.infos)

    def number(self, name: str) -> int:
        """Number of a property that is the same in all pucks, as that of P, T and MODE."""
        return self.infos[0].number(name)

    def angles(self, counts: Sequence[float]) -> Vector4:
        """Joint angles [rad] at the motors' counts."""
        return self._angles(counts)

    def counts(self, angles: Sequence[float]) -> Units:
        """Motor counts at joint angles [rad], rounded down as libbarrett does."""
        motor = apply(JOINT_TO_MOTOR, tuple(map(float, angles)))
        per_radian = (info.counts_per_turn / (2.0 * pi) for info in self.infos)
        a, b, c, d = (floor(angle * each) for angle, each in zip(motor, per_radian, strict=True))
        return a, b, c, d

    def units(self, torque: Sequence[float]) -> Units:
        """Puck units for joint torques [N m], rounded down as libbarrett does; nothing is clamped here.

        Raises:
            ValueError: A torque is NaN.
            OverflowError: A torque is infinite.
        """
        a, b, c, d = self._units(torque)
        return floor(a), floor(b), floor(c), floor(d)

    def torque(self, units: Sequence[int]) -> Vector4:
        """Joint torques [N m] that the motors give for puck units."""
        return self._torque(units)
