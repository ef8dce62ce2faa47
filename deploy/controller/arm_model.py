"""What a controller of the kind "wam" knows of its arm: model, posture, filter, limits and the trace of its tick."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from deploy.controller.checks import AGAIN, array, constants, keyed
from deploy.controller.limits import Limits
from deploy.controller.margin_floor import number
from jaxmpc.files.errors import InputError
from jaxmpc.law.chain import Chain, Link, mass_matrix, pose, tip
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.law.momentum_observer import FASTEST
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import Vector

ROBOT = "Barrett WAM 4-DoF"
DH = (
    (0.0, -0.5 * math.pi, 0.0),
    (0.0, 0.5 * math.pi, 0.0),
    (0.045, -0.5 * math.pi, 0.55),
    (-0.045, 0.5 * math.pi, 0.0),
)
"""Its a [m], α [rad] and d [m] per joint (libbarrett, config/wam4.conf; distal convention)."""
LINK: Mapping[str, tuple[int, ...]] = {
    "position": (3,), "rotation": (3, 3), "mass": (), "moment": (3,), "inertia": (3, 3),
}  # fmt: skip
CHAIN: Mapping[str, tuple[int, ...]] = {"armature": (4,), "tip": (3,), "gravity": (3,)}
TOOL = (-2.0, 12.0)
"""Mass that a model may have at the tip besides its chain's [kg]: an experiment's tool weighs up to 4 kg, is off by as
much, and is believed in up to twice."""
FRICTION: Mapping[str, tuple[int, ...]] = {"coulomb": (4,), "viscous": (4,), "presliding": ()}
GOLDEN = ("golden_q", "golden_applied", "golden_torque")
KNOWN = ("golden_known", "golden_memory")
"""The arrays that a controller with a schedule has besides."""
MEANING: Mapping[str, str] = {
    "robot": "the name of the arm that it may drive",
    "chain": "masses and geometry of the links",
    "tool_length": "where the tip is beyond the elbow",
    "nominal": "how its model of masses, tool and friction differs",
    "compensated": "whether it cancels friction",
    "posture": "the joint angles at which the redundant joint rests",
    "encoder_counts": "the encoders that it was judged with",
    "limits": "what force, torque, velocity and place may never pass",
}
"""What each entry of the table is; without any of them the controller drives nothing."""


@dataclass(frozen=True, eq=False)
class ArmModel:
    """The arm in the controller's model; whatever exists is well formed and is the robot that it names.

    Attributes:
        robot: Name of the robot.
        chain: Its constants, floats.
        tool_length: From the elbow's axis to the tip [m].
        nominal: How its model differs from them, and the friction in it.
        compensated: Whether that friction is cancelled.
        posture: Joint angles of the null space, J1–J4 [rad].
        encoder_counts: Per motor turn, of the arm it was judged on; 0 is a perfect encoder.
        limits: What nothing may pass.
        golden_q: Measured joint angles of the trace (n, 4) [rad], which begins at rest at its first row.
        golden_applied: Joint torques (n, 4) [N m] that the observers were told of after each sample.
        golden_torque: What the JAX law wanted (n, 4) [N m].
        momentum_observer: Bandwidth of the observer that cancels what disturbs the joints' momentum [rad/s]; 0 is none.
        golden_known: What the law wanted with each stiffness of `known_tissue` taken for known (knots + 2, m, 4) [N m];
            None without a schedule.
        golden_memory: All that it remembered after the last of these samples (knots + 2, numbers); None likewise.

    Raises:
        InputError: A value is malformed, out of range, or not the named robot's.
    """

    robot: str
    chain: Chain
    tool_length: float
    nominal: Nominal
    compensated: bool
    posture: Vector
    encoder_counts: int
    limits: Limits
    golden_q: np.ndarray
    golden_applied: np.ndarray
    golden_torque: np.ndarray
    momentum_observer: float = 0.0
    golden_known: np.ndarray | None = None
    golden_memory: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.robot != ROBOT:
            raise InputError("arm.robot", self.robot, repr(ROBOT), "Freeze a controller for the robot that you have.")
        if not isinstance(self.compensated, bool):
            raise InputError("arm.compensated", self.compensated, "true or false", AGAIN)
        if not isinstance(self.limits, Limits):
            raise InputError("arm.limits", self.limits, "a table of limits", AGAIN)
        if self.compensated and self.momentum_observer:
            raise InputError("arm.momentum_observer", self.momentum_observer, "0 beside arm.compensated", AGAIN)
        counts = self.encoder_counts
        if isinstance(counts, bool) or not isinstance(counts, int) or not 0 <= counts <= 10_000_000:
            raise InputError("arm.encoder_counts", counts, "a whole number in [0, 10000000]", "The arm's has 4096.")
        q = array("golden_q", self.golden_q, (None, 4))
        checked = {
            "chain": _chain(self.chain),
            "tool_length": _between("arm.tool_length", self.tool_length, 0.0, 1.0),
            "nominal": _nominal(self.nominal),
            "momentum_observer": _between("arm.momentum_observer", self.momentum_observer, 0.0, FASTEST),
            "posture": constants("arm.posture", self.posture, (4,)),
            "golden_q": q,
            "golden_applied": array("golden_applied", self.golden_applied, (len(q), 4)),
            "golden_torque": array("golden_torque", self.golden_torque, (len(q), 4)),
        }
        for name, shape in zip(KNOWN, ((None, None, 4), (None, None)), strict=True):
            if getattr(self, name) is not None:
                checked |= {name: array(name, getattr(self, name), shape)}
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_robot()
        self._check_limits()

    def _check_robot(self) -> None:
        """The geometry is the named robot's, and its mass matrix can be one."""
        for q in (self.posture, (0.3, -0.7, 0.5, 1.9)):
            at = pose(self.chain, q, FLOATS)
            miss = float(np.linalg.norm(np.subtract(tip(self.chain, at).position, published_tip(q, self.tool_length))))
            if not miss <= 1e-6:
                bound = f"that of a {ROBOT} with a tool of {self.tool_length:g} m"
                raise InputError("arm.chain", f"another arm: its tip is {1e3 * miss:.3g} mm off", bound, AGAIN)
            mass = np.array(mass_matrix(self.chain, at)) * self.nominal.mass_scale + np.diag(self.chain.armature)
            if not np.all(np.linalg.eigvalsh(mass) > 0.0):
                raise InputError("arm.chain", "a mass matrix that is not one", "positive definite", AGAIN)

    def _check_limits(self) -> None:
        """The posture and the controller's own run stay within the limits."""
        limits = self.limits
        remedy = "Choose limits that its own run keeps, or another controller."
        for i, (low, high) in enumerate(limits.joint_range):
            for name, angles in (("arm.posture", np.array([self.posture])), ("golden_q", self.golden_q)):
                if not (np.all(angles[:, i] >= low) and np.all(angles[:, i] <= high)):
                    raise InputError(f"{name} of J{i + 1}", f"{angles[0, i]:g}", f"in [{low:g}, {high:g}] rad", remedy)
            most = float(np.max(np.abs(self.golden_torque[:, i])))
            if most > limits.joint_torque[i]:
                bound = f"at most {limits.joint_torque[i]:g} N m, its limit"
                raise InputError(f"golden_torque of J{i + 1}", f"{most:.3g} N m", bound, remedy)
        at = tip(self.chain, pose(self.chain, self.posture, FLOATS)).position
        for name, x, (low, high) in zip("xyz", at, limits.workspace, strict=True):
            if not low <= x <= high:
                raise InputError(f"tip at arm.posture, {name}", f"{x:.4g} m", f"in [{low:g}, {high:g}] m", remedy)

    def plain(self) -> dict[str, Any]:
        """Everything but the trace, as plain data; an observer that is none is left out."""
        without = (*GOLDEN, *KNOWN) if self.momentum_observer else (*GOLDEN, *KNOWN, "momentum_observer")
        table = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in without}
        links = [link._asdict() for link in self.chain.links]
        nominal = self.nominal._asdict() | {"friction": self.nominal.friction._asdict()}
        return table | {
            "chain": self.chain._asdict() | {"links": links},
            "nominal": nominal,
            "limits": self.limits.plain(),
        }

    @classmethod
    def from_plain(cls, table: Any, golden: Mapping[str, Any]) -> "ArmModel":
        """The model from a table as `plain` gives it, and the arrays of its trace.

        Raises:
            InputError: Something is missing, unknown, malformed or out of range; it is named.
        """
        if isinstance(table, Mapping):
            table = {"momentum_observer": 0.0, **table}
        known = keyed("arm", table, (*MEANING, "momentum_observer"), MEANING)
        missing = [name for name in GOLDEN if name not in golden]
        if missing:
            raise InputError(missing[0], "missing", "given: the trace tells whether the torques are right", AGAIN)
        trace: dict[str, Any] = {name: golden.get(name) for name in (*GOLDEN, *KNOWN)}
        return cls(**(known | {"limits": Limits.from_plain(known["limits"])}), **trace)


def published_tip(q: Vector, tool_length: float) -> np.ndarray:
    """Tip of the robot from its published Denavit–Hartenberg table, shape (3,) [m]; no code of the chain's."""
    frame = np.eye(4)
    for angle, (a, alpha, d) in zip((*q, 0.0), (*DH, (0.0, 0.0, tool_length)), strict=True):
        s, c, sa, ca = math.sin(angle), math.cos(angle), math.sin(alpha), math.cos(alpha)
        frame = frame @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]]
        )
    return frame[:3, 3]


def _chain(value: Any) -> Chain:
    """A chain of floats, from one or from the table of one."""
    table = keyed("arm.chain", value, ("links", *CHAIN))
    links = table["links"]
    if not isinstance(links, list | tuple) or len(links) != 4:
        raise InputError("arm.chain.links", links, "four links", AGAIN)
    made = []
    for i, link in enumerate(links):
        name = f"arm.chain.links[{i}]"
        parts = keyed(name, link, LINK)
        made.append(Link(**{key: constants(f"{name}.{key}", parts[key], shape) for key, shape in LINK.items()}))
        if not made[-1].mass > 0.0:
            raise InputError(f"{name}.mass", made[-1].mass, "positive [kg]", AGAIN)
    rest = {key: constants(f"arm.chain.{key}", table[key], shape) for key, shape in CHAIN.items()}
    if not min(rest["armature"]) >= 0.0:
        raise InputError("arm.chain.armature", rest["armature"], "not negative [kg m²]", AGAIN)
    if not 9.7 <= math.hypot(*rest["gravity"]) <= 9.9:
        raise InputError("arm.chain.gravity", rest["gravity"], "of 9.7 to 9.9 m/s²", AGAIN)
    return Chain(tuple(made), **rest)


def _nominal(value: Any) -> Nominal:
    """The nominal model, as floats."""
    table = keyed("arm.nominal", value, Nominal._fields)
    friction = keyed("arm.nominal.friction", table["friction"], FRICTION)
    known = {key: constants(f"arm.nominal.friction.{key}", friction[key], shape) for key, shape in FRICTION.items()}
    if min(*known["coulomb"], *known["viscous"]) < 0.0:
        raise InputError("arm.nominal.friction", friction, "not negative", "Friction never drives a joint.")
    _between("arm.nominal.friction.presliding", known["presliding"], 1e-5, 0.1)
    mass_scale = _between("arm.nominal.mass_scale", table["mass_scale"], 0.1, 2.0)
    tool_error = _between("arm.nominal.tool_error", table["tool_error"], *TOOL)
    return Nominal(mass_scale, tool_error, NominalFriction(**known))


def _between(name: str, value: Any, low: float, high: float) -> float:
    found = number(name, value)
    if not low <= found <= high:
        raise InputError(name, found, f"in [{low:g}, {high:g}]", AGAIN)
    return found
