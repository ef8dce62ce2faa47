"""Limits of the robot: declared with every controller, checked, and bounded by what nobody may exceed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, NamedTuple, get_type_hints

from jaxmpc.files.errors import InputError, within
from jaxmpc.law.vectors import Vector4

Range = tuple[float, float]
Ranges = tuple[Range, Range, Range, Range]
Box = tuple[Range, Range, Range]

MECHANICAL_STOPS: Ranges = ((-2.6, 2.6), (-2.0, 2.0), (-2.8, 2.8), (-0.9, 3.15))
"""Mechanical stops of the joints [rad] (WAM User's Manual; J4 so that it contains home)."""
REACH = 1.0
"""Radius that contains all the tip can reach [m] (Barrett)."""


class LimitRow(NamedTuple):
    """Declaration of a limit.

    Attributes:
        unit: Unit of its numbers.
        default: Value for work on soft tissue; None where it depends on the tip's place.
        lowest, highest: Least and most that anybody can declare, one number or one for each.
        widest: Ranges within which the declared ones lie, in place of `lowest` and `highest`.
        optional: Whether a file older than the limit takes its default; else every file declares it.
    """

    unit: str
    default: Any
    lowest: Any = None
    highest: Any = None
    widest: Sequence[Range] = ()
    optional: bool = False


@dataclass(frozen=True)
class Limits:
    """Limits that are never exceeded; whatever exists is complete, finite and within what nobody can exceed.

    A smaller least torque or rate would leave no whole puck unit between two limits; a smaller singular value would
    not keep the arm from losing a direction. The largest are the cable limits MT of the pucks (4860 and 4320 units at
    2700 per N m) and what they make at the joints, OpenWAM's fastest joint, the speed at which the arm's own safety
    board cuts it off (wam.md §2.5, §3.5).

    Default torques are half of what the cables bear: libbarrett's own 20 N m on J2 leave 12 beside gravity, and a
    controller that meets a beating heart needs 20 for some milliseconds; cut off there it may lose its stability, as
    any loop with a gain reduction margin does. Joint ranges are OpenWAM's (§1.3); the rest is chosen here. The law
    turns counts of the force sensor into torque at once: clean runs of Table I on the simulated arm change it by up to
    1.8, 4.7, 1.3 and 1.0 N m a sample, on viscous tissue (1900 N/m) by 2.9, 7.5, 2.0 and 1.5. So the usual 1 N m a
    sample would clamp all the time; 1.3 times the largest of those does not.

    Attributes:
        force: Largest force on the tissue, Euclidean norm [N].
        joint_torque: Largest torque of each joint, either way (4,) [N m].
        motor_torque: Largest torque of each motor, either way (4,) [N m]; J2 and J3 share motors 2 and 3.
        torque_rate: Fastest change of each joint's torque (4,) [N m/s].
        joint_velocity: Fastest each joint may turn (4,) [rad/s].
        tip_velocity: Fastest the tip, or the elbow, may move [m/s].
        joint_range: Lowest and highest angle of each joint (4, 2) [rad].
        workspace: Lowest and highest x, y and z of the tip in the shoulder's frame (3, 2) [m].
        least_singular_value: Smallest that the tip's 3×4 Jacobian may have [m/rad].
        overshoot: Largest measured push over the largest wanted one with which a run ends `finished` [-].

    Raises:
        InputError: A value is malformed or out of bounds.
    """

    force: Annotated[float, LimitRow("N", 15.0, 0.1, 100.0)]
    joint_torque: Annotated[Vector4, LimitRow("N m", (37.0, 50.0, 30.0, 14.0), (1.0,) * 4, (75.6, 101.7, 60.53, 28.8))]
    motor_torque: Annotated[Vector4, LimitRow("N m", (1.8, 1.8, 1.8, 1.6), (0.1,) * 4, (1.8, 1.8, 1.8, 1.6))]
    torque_rate: Annotated[Vector4, LimitRow("N m/s", (4000.0, 10000.0, 3000.0, 2000.0), (200.0,) * 4, (12000.0,) * 4)]
    joint_velocity: Annotated[Vector4, LimitRow("rad/s", (2.0,) * 4, (0.01,) * 4, (2.5,) * 4)]
    tip_velocity: Annotated[float, LimitRow("m/s", 0.28, 0.01, 1.0)]
    joint_range: Annotated[
        Ranges, LimitRow("rad", ((-2.60, 2.60), (-1.96, 1.96), (-2.73, 2.73), (-0.86, 3.13)), widest=MECHANICAL_STOPS)
    ]
    workspace: Annotated[Box, LimitRow("m", None, widest=((-REACH, REACH),) * 3)]
    least_singular_value: Annotated[float, LimitRow("m/rad", 0.05, 0.02, 0.3)]
    overshoot: Annotated[float, LimitRow("-", 1.2, 1.0, 10.0, optional=True)] = 1.2

    def __post_init__(self) -> None:
        for name, row in ROWS.items():
            object.__setattr__(self, name, _checked(name, getattr(self, name), row))

    @classmethod
    def default(cls, tip: Sequence[float]) -> "Limits":
        """Limits for work on soft tissue, 0.10 m to either side of the tip.

        Args:
            tip: Where the tip works, in the shoulder's frame (3,) [m].
        """
        box = tuple((max(at - 0.10, -REACH), min(at + 0.10, REACH)) for at in _sequence("tip", tip, 3))
        return cls(**{name: row.default for name, row in ROWS.items()} | {"workspace": box})

    @classmethod
    def from_plain(cls, table: Any) -> "Limits":
        """Limits from plain data, as a file holds them.

        Raises:
            InputError: It is no table, lacks a mandatory limit, has an unknown one, or a value is out of bounds.
        """
        names = ", ".join(ROWS)
        if not isinstance(table, Mapping):
            raise InputError("limits", table, f"a table of {names}", "Declare every limit.")
        if missing := [name for name, row in ROWS.items() if not row.optional and name not in table]:
            remedy = "Every limit is mandatory: decide on it and freeze the controller again."
            raise InputError(f"limits.{missing[0]}", "missing", f"given [{ROWS[missing[0]].unit}]", remedy)
        if unknown := sorted(str(name) for name in table if name not in ROWS):
            raise InputError(f"limits.{unknown[0]}", "unknown", f"one of {names}", "Leave it out.")
        return cls(**{name: row.default for name, row in ROWS.items() if row.optional} | dict(table))

    def plain(self) -> dict[str, Any]:
        """Plain data: numbers, and lists of them; `from_plain` takes it back."""
        return {name: _lists(value) for name, value in asdict(self).items()}


_HINTS = get_type_hints(Limits, include_extras=True)
ROWS: Mapping[str, LimitRow] = {name: hint.__metadata__[0] for name, hint in _HINTS.items()}
"""All limits by name, in the order of the fields."""


def _checked(name: str, value: Any, row: LimitRow) -> Any:
    if row.widest:
        return _ranges(name, value, row)
    if not isinstance(row.highest, tuple):
        return _between(name, value, row.lowest, row.highest, row.unit)
    bounds = zip(_sequence(name, value, len(row.highest)), row.lowest, row.highest, strict=True)
    return tuple(_between(f"{name}[{i}]", *each, row.unit) for i, each in enumerate(bounds))


def _between(name: str, value: Any, lowest: float, highest: float, unit: str) -> float:
    number = _number(name, value)
    if not lowest <= number <= highest:
        remedy = "Nobody can declare a limit outside of that: see deploy/controller/limits.py."
        raise InputError(f"limits.{name}", f"{number:g}", within(lowest, highest, unit), remedy)
    return number


def _ranges(name: str, value: Any, row: LimitRow) -> Any:
    pairs = [_sequence(f"{name}[{i}]", pair, 2) for i, pair in enumerate(_items(name, value, len(row.widest)))]
    for i, ((low, high), (lowest, highest)) in enumerate(zip(pairs, row.widest, strict=True)):
        if not lowest <= low < high <= highest:
            bound = f"a range from low to high within [{lowest:g}, {highest:g}] {row.unit}"
            raise InputError(f"limits.{name}[{i}]", f"{low:g} to {high:g}", bound, "Nothing beyond can be reached.")
    return tuple(pairs)


def _sequence(name: str, value: Any, length: int) -> tuple[float, ...]:
    return tuple(_number(f"{name}[{i}]", each) for i, each in enumerate(_items(name, value, length)))


def _items(name: str, value: Any, length: int) -> list[Any]:
    if isinstance(value, str | bytes | Mapping) or not hasattr(value, "__iter__") or len(list(value)) != length:
        raise InputError(f"limits.{name}", value, f"a list of {length}", "Give one entry for each.")
    return list(value)


def _number(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool | str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"limits.{name}", value, "a finite number", "Say it in SI units.")
    return number


def _lists(value: Any) -> Any:
    return [_lists(each) for each in value] if isinstance(value, tuple) else value
