"""The tables of a sweep's file, as they are written."""

from typing import Annotated, Any, Literal

import msgspec

from jaxmpc.world.heart.bounds import Seed
from sweeps.axis import Drawn
from sweeps.goal import DECIDE, Decide
from sweeps.space import MOST_ROWS

Ends = tuple[float, float]
Precision = Literal["float32", "float64"]
OnError = Literal["keep", "stop"]


class Range(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A range of a parameter, in its unit: `linear` or `log`, and for a grid the number of points."""

    linear: Ends | None = None
    log: Ends | None = None
    points: Annotated[int, msgspec.Meta(ge=2, le=100_000)] | None = None
    values: list[Any] | None = None
    """A list, where something else is to be said of it."""
    draw: Drawn | None = None
    """How the points of a grid are drawn on the range; without it they are evenly spaced."""
    seed: Seed | None = None
    """For `draw` alone; None is 0."""
    relative: bool = False
    """Whether the numbers multiply what the base has there."""


RANGE_KEYS = frozenset(field.name for field in msgspec.structs.fields(Range))


class SweepTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [sweep] of a spec."""

    kind: Literal["grid", "random", "sobol"]
    axes: dict[str, Any] = {}
    """A list of values or a `Range` for each swept parameter."""
    zip: list[dict[str, Any]] = []
    """Each entry has axes that advance together."""
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS)] | None = None
    """Size of a sample."""
    seed: Seed | None = None
    """Seed of a sample."""
    precision: Precision | None = None
    """Precision of the time stepping, of which None is as `sweeps.precision` finds; design and margins are always
    float64."""
    stiffness_sets: dict[str, list[float]] = {}
    """Stiffness sets by name [N/m]."""
    columns: list[str] | None = None
    """Metrics and margins that are kept; None is all."""
    best: str = "rms"
    """What ranks the rows."""
    constraints: dict[str, float] | None = None
    """Limits that a good row keeps; None is M_s ≤ 2."""
    decide: Decide = DECIDE
    """How many of the rows that float32 cannot decide run once more in float64, at most; 0 is none."""
    on_error: OnError = "keep"
    """What to do about a chunk that cannot be computed: set it aside, or stop."""


class Stage(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A cheaper experiment before the spec's own, and how many rows go on from it."""

    keep: Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS)]
    """Best rows that go on."""
    experiment: dict[str, Any] = {}
    """Keys of the experiment to change: a shorter `duration` and `settle`, `physics = "linear"`."""


class Rerun(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A dearer experiment at the end, for the best rows alone."""

    best: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 10
    """How many rows."""
    experiment: dict[str, Any] = msgspec.field(default_factory=lambda: {"physics": "wam"})
    """Keys of the experiment to change."""


class RefineTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [refine] of a spec."""

    method: Literal["halving", "pareto", "none"] = "none"
    """"halving": cheap stages first, the spec's experiment for the survivors. "pareto": more rows around the front."""
    stages: tuple[Stage, ...] = ()
    """Halving: the cheap experiments, in order."""
    goals: tuple[str, ...] = ("rms", "M_s")
    """Pareto: what spans the front."""
    rounds: Annotated[int, msgspec.Meta(ge=1, le=20)] = 3
    """Pareto: how often rows are added."""
    points: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 256
    """Pareto: how many each time."""
    seed: Seed = 0
    """Pareto: seed of what is drawn around the front."""
    rerun: Rerun | None = None
    """What the best rows are run on once more."""
