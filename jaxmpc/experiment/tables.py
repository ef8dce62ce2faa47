"""The tables [sensor], [tissue] and [arm] of an experiment: which robot presses on what, and how imperfect all are.

The defaults are the nominal imperfect arm on the paper's elastic tissue. Every imperfection can be switched off by
itself with a zero.
"""

from functools import lru_cache
from itertools import pairwise
from types import GenericAlias
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.toml import told_by_type
from jaxmpc.law.momentum_observer import FASTEST
from jaxmpc.law.scalar import Vector
from jaxmpc.law.transmission import IPNM, MOTOR_TORQUE_LIMIT
from jaxmpc.world.arm import TOOL_MASS, joint_ranges, posture_at
from jaxmpc.world.heart.bounds import Seed, Size
from jaxmpc.world.tissue import LAWS
from jaxmpc.world.tissue.base import TissueConstant

Angle = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
Metre = Annotated[float, msgspec.Meta(ge=-2.0, le=2.0)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=2.0)]
Kilogram = Annotated[float, msgspec.Meta(ge=-1.0, le=4.0)]
Torque = Annotated[float, msgspec.Meta(ge=0.0, le=200.0)]
Bandwidth = Annotated[float, msgspec.Meta(ge=0.0, le=FASTEST)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)]
Torques = tuple[Torque, Torque, Torque, Torque]


class SensorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The JR3 force sensor; zero switches an imperfection off."""

    noise: Size = 0.010
    """Standard deviation of white noise per sample [N] (prior; the maker publishes none)."""
    lsb: tuple[Size, Size, Size] = (0.0061, 0.0061, 0.0122)
    """Least significant bit per axis, 2¹⁴ counts on 100/100/200 N [N]."""
    lowpass_hz: Annotated[float, msgspec.Meta(ge=0.0, le=1e4)] | None = None
    """Cut-off of the built-in low-pass [Hz]; 0 is none. None is the JR3's fastest, 500, and none with ideal damping."""
    kalman: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 0.0
    """Change of the force rate per sample that a Kalman filter on the measured force assumes [N/s]; 0 is no filter.
    Part of the controller, on the linear loop as on the arm."""
    seed: Seed = 0


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The tissue turns stiffer or softer under way."""

    at: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)]
    """When it begins [s]."""
    factor: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
    """New stiffness over the experiment's [-]."""
    duration: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 0.2
    """How long it takes [s]."""


def _key(constant: TissueConstant) -> tuple[str, Any, Any]:
    """Name, type and default of a key."""
    kind: Any = Annotated[float, msgspec.Meta(ge=constant.low, le=constant.high)]
    if isinstance(constant.default, tuple):
        kind = GenericAlias(tuple, (kind,) * len(constant.default))
    return constant.name, kind, constant.default


_TissueConstants: Any = msgspec.defstruct(
    "_TissueConstants", [_key(constant) for law in LAWS.values() for constant in law.parameters]
)
"""The constants of every law: each reads its own."""


class TissueSettings(_TissueConstants, frozen=True, forbid_unknown_fields=True):  # type: ignore[misc,call-arg]  # made above
    """What the tip presses on; the stiffness itself is the experiment's, the constants are those of the laws."""

    kind: str = "elastic"
    """Name of a law of `jaxmpc.world.tissue`."""
    attached: bool = True
    """Whether it holds the tip, as in the paper; else contact can be lost."""
    changes: tuple[Change, ...] = ()
    """Changes of stiffness under way, in order of time."""

    def __post_init__(self) -> None:
        with told_by_type(self, "tissue"):
            self._check_together()

    def _check_together(self) -> None:
        """Refuse a law that is none, and changes that are none or out of order."""
        if self.kind not in LAWS:
            raise InputError("tissue.kind", self.kind, "a known law", nearest(self.kind, list(LAWS)))
        if wrong := [change for change in self.changes if not isinstance(change, Change)]:
            raise InputError("tissue.changes", wrong[0], "a tuple of Change", "A file has tables for them.")
        begins = [change.at for change in self.changes]
        for k, (first, then) in enumerate(pairwise(begins)):
            if then < first:
                remedy = "Sort them: each goes on from what the one before it has left."
                raise InputError(
                    f"tissue.changes[{k + 1}].at", then, f"at least {first:g} s, as the one before", remedy
                )

    @property
    def constants(self) -> tuple[Any, ...]:
        """Constants of its own law."""
        return tuple(getattr(self, constant.name) for constant in LAWS[self.kind].parameters)

    @property
    def linear(self) -> bool:
        """Whether the linear world can have it: a spring that holds the tip and stays as it is."""
        return not self.beyond_linear

    @property
    def beyond_linear(self) -> list[tuple[str, Any]]:
        """Keys, with their values, that the linear world cannot have."""
        kept = {"kind": "elastic", "attached": True, "changes": ()}
        return [(key, getattr(self, key)) for key, value in kept.items() if getattr(self, key) != value]


def softening(tissue: TissueSettings, t: np.ndarray) -> np.ndarray:
    """Factor on the stiffness over time, shape (steps,) [-]."""
    factor = np.ones(len(t))
    for change in tissue.changes:
        s = np.clip((t - change.at) / change.duration, 0.0, 1.0) if change.duration else (t >= change.at) * 1.0
        factor += (change.factor - factor) * s**2 * (3.0 - 2.0 * s)
    return factor


_reached = lru_cache(maxsize=64)(posture_at)

RESOLVED = 100.0
"""Fastest cable mode that a single substep of 1 ms follows [Hz]; damping and an outstretched arm ask for more of them
(`jaxmpc.world.cable`)."""


class ArmSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The 4-DoF WAM and its imperfections."""

    posture: tuple[Angle, Angle, Angle, Angle] = (0.0, 0.7, 0.0, 2.2)
    """Joint angles at the start, J1–J4 [rad]."""
    target: tuple[Metre, Metre, Metre] | None = None
    """Where the tip is to touch, in the shoulder frame [m]; chooses the posture nearest to `posture`."""
    integrator: Literal["leapfrog", "euler"] = "leapfrog"
    """"euler" is MuJoCo's, for comparisons."""
    substeps: Annotated[int, msgspec.Meta(ge=1, le=64)] = 1
    """Physics steps per sample."""
    tool_mass: Annotated[float, msgspec.Meta(ge=0.0, le=4.0)] = TOOL_MASS
    """Tool and sensor at the tip; the controller knows it as well as the links, by `mass_error` [kg]."""
    beyond_sensor: Annotated[float, msgspec.Meta(ge=0.0, le=4.0)] = 0.0
    """Part of it whose inertia the force sensor reads; its weight is tared [kg]."""
    coulomb: Torques = (2.025, 2.25, 1.125, 0.66)
    """Coulomb friction of the joints [N m] (OWD; the other published row is 1.6, 0.53, 0.35, 0.63)."""
    presliding: Annotated[float, msgspec.Meta(ge=1e-5, le=0.1)] = 1e-3
    """Deflection at which it is fully there [rad] (prior)."""
    viscous: Torques = (1.5, 0.9, 0.5, 0.25)
    """Viscous friction of the joints [N m s/rad] (OWD; the other published row is 1.63, 2.372, 0.8554, 0.6153)."""
    compensation: Share = 0.0
    """Share of the friction that the controller compensates [-]."""
    momentum_observer: Bandwidth = 0.0
    """Bandwidth of the observer of the joints' momentum that cancels friction without a model [rad/s]; 0 is none."""
    nominal_coulomb: Torques | None = None
    """Coulomb friction of which it compensates that share [N m]; none is the true one."""
    nominal_viscous: Torques | None = None
    """Viscous friction of which it compensates that share [N m s/rad]; none is the true one."""
    nominal_presliding: Annotated[float, msgspec.Meta(ge=1e-5, le=0.1)] | None = None
    """Deflection at which it believes friction to be fully there [rad]; none is the true one."""
    mass_error: Annotated[float, msgspec.Meta(gt=-0.9, le=1.0)] = -0.1
    """Relative error of the masses and inertias that the controller believes [-]."""
    tool_mass_error: Kilogram = 0.0
    """Mass at the tip that only the controller believes in [kg]."""
    encoder_counts: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)] = 4096
    """Per motor turn; 0 is a perfect encoder."""
    torque_lsb: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 1.0 / IPNM
    """Motor torque per unit of the command [N m]; 0 is a perfect one."""
    torque_limit: Torques = MOTOR_TORQUE_LIMIT
    """Largest torque of each motor [N m]."""
    joint_torque_limit: Torques = (50.0, 50.0, 50.0, 50.0)
    """Largest torque of each joint [N m]; 0 is no limit. By default all have that of the robot's clamp on joint 2."""
    torque_step_limit: Torques = (10.0, 10.0, 10.0, 10.0)
    """Largest change of a joint's torque from one sample to the next, the same [N m]; 0 is no limit."""
    cable_hz: Annotated[float, msgspec.Meta(ge=0.0, le=300.0)] = 0.0
    """Cable mode of each joint against its locked motor [Hz] (90–250 plausible, 15–60 stress); 0 is a rigid cable."""
    cable_damping: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.05
    """Its damping ratio [-] (prior 0.03–0.1)."""

    def __post_init__(self) -> None:
        with told_by_type(self, "arm"):
            self._check_together()

    def _check_together(self) -> None:
        """Refuse values that do not go together."""
        if self.compensation and self.momentum_observer:
            bound = f"0 beside arm.compensation = {self.compensation:g}"
            remedy = "Cancel friction by one of them: set the other to 0."
            raise InputError("arm.momentum_observer", self.momentum_observer, bound, remedy)
        if self.cable_hz and self.integrator == "euler":
            raise InputError("arm.integrator", "euler", '"leapfrog" with a cable mode', "Set arm.cable_hz = 0.")
        if self.cable_hz > RESOLVED * self.substeps:
            bound = f"at most {RESOLVED:g} Hz per substep (arm.substeps = {self.substeps})"
            remedy = "Raise arm.substeps: five resolve 250 Hz."
            raise InputError("arm.cable_hz", self.cable_hz, bound, remedy)
        if self.beyond_sensor > self.tool_mass:
            bound = f"at most arm.tool_mass (= {self.tool_mass:g} kg)"
            raise InputError("arm.beyond_sensor", self.beyond_sensor, bound, "The sensor is part of the tool.")

    def resting(self) -> Vector:
        """Joint angles at the start [rad].

        Raises:
            InputError: The posture is out of the joint limits, or no posture reaches the target.
        """
        for name, angle, (low, high) in zip(("J1", "J2", "J3", "J4"), self.posture, joint_ranges(), strict=True):
            if not low <= angle <= high:
                bound = f"in [{low:g}, {high:g}] rad for {name}"
                raise InputError("arm.posture", angle, bound, "Choose a posture within the joint limits.")
        if self.target is None:
            return tuple(map(float, self.posture))
        return _reached(tuple(self.target), tuple(self.posture))
