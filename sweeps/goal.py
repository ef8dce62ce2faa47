"""What makes a row a good one: a quantity to be minimised, and limits that it must keep."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any

import msgspec

from jaxmpc.files.errors import InputError, check_type, counted, nearest
from jaxmpc.files.toml import without_arrays
from jaxmpc.quantities import HIGHEST_M_S, MARGINS, METRICS, Quantity, check_limit

MEASURED: Mapping[str, Quantity] = MappingProxyType({**METRICS, **MARGINS})
"""What can be ranked, limited and kept."""

SWING = "swing"
ON_ARM = frozenset({SWING, *(name for name, metric in METRICS.items() if metric.arm_only)})
"""What sweeps of the linear loop do not measure: there it is NaN, or 0 for want of joints."""

MOST_DECIDED = 100_000
Decide = Annotated[int, msgspec.Meta(ge=0, le=MOST_DECIDED)]
DECIDE = 1000
"""Rows that run once more in float64 at most, unless a spec says otherwise."""


class SweepGoal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How rows are ranked; no bit of a row depends on it.

    Attributes:
        best: The metric or margin that ranks, at its worst over stiffness and axis.
        constraints: Limit of each quantity that must be kept at every stiffness and axis, in its unit: a ceiling or a
            floor, as the quantity is.
        decide: How many of the rows that float32 cannot decide run once more in float64, at most.
    """

    best: str = "rms"
    constraints: dict[str, float] = msgspec.field(default_factory=lambda: {"M_s": HIGHEST_M_S})
    decide: Decide = DECIDE

    def __post_init__(self) -> None:
        for key, name in (("sweep.best", self.best), *((f"sweep.constraints.{n}", n) for n in self.constraints)):
            if name not in MEASURED:
                raise InputError(key, name, "a metric or margin", nearest(name, list(MEASURED)))
        # As plain data, whatever numbers they came in: they are written into manifests.
        limits = without_arrays(self.constraints)
        for name, limit in limits.items():
            check_limit(f"sweep.constraints.{name}", MEASURED[name], limit, "Remove it for no limit.", zero=True)
        msgspec.structs.force_setattr(self, "constraints", limits)
        most = counted("sweep.decide", self.decide, "0 runs none once more.", 0, MOST_DECIDED)
        msgspec.structs.force_setattr(self, "decide", most)

    @property
    def names(self) -> tuple[str, ...]:
        """Quantities that it needs, each once."""
        return tuple(dict.fromkeys((self.best, *self.constraints)))

    def limited(self, changes: Mapping[str, Any]) -> "SweepGoal":
        """The same with some limits changed."""
        return msgspec.structs.replace(self, constraints={**self.constraints, **changes})

    @property
    def text(self) -> str:
        """It, for a person."""
        sense = "least" if MEASURED[self.best].ceiling else "largest"
        limits = ", ".join(f"{name} {MEASURED[name].sign} {limit:g}" for name, limit in self.constraints.items())
        return f"{sense} {self.best}" + (f" with {limits}" if limits else "")


def check_goal(goal: Any) -> None:
    """Refuse what is no `SweepGoal`, such as the name of what ranks.

    Raises:
        InputError: It is of another type.
    """
    check_type("goal", goal, SweepGoal, 'Give SweepGoal("rms", {"M_s": 2.0}).')


def columns_kept(chosen: list[str] | None, goal: SweepGoal) -> tuple[str, ...]:
    """Metrics and margins that a sweep keeps, in the order of the tables; what ranks is always among them.

    Raises:
        InputError: One is unknown.
    """
    for name in chosen or ():
        if name not in MEASURED:
            raise InputError("sweep.columns", name, "a metric or margin", nearest(name, list(MEASURED)))
    wanted = set(MEASURED) if chosen is None else {*chosen, *goal.names, "rms", "M_s"}
    return tuple(name for name in MEASURED if name in wanted)
