"""What is swept, from a TOML file: experiment, base controller, axes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from jaxmpc.experiment import Experiment
from jaxmpc.experiment.job import experiment_table, params_table
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.toml import convert, known_keys, known_tables, located, read_toml
from jaxmpc.quantities import PARAMETERS
from jaxmpc.synthesis.params import Params
from jaxmpc.world.heart.bounds import Seed
from sweeps.space import MOST_ROWS, Scale, SweepAxis, SweepSpace, make_axis, make_space

Ends = tuple[float, float]
Precision = Literal["float32", "float64"]


class Range(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A range of a parameter, in its unit: `linear` or `log`, and for a grid the number of points."""

    linear: Ends | None = None
    log: Ends | None = None
    points: Annotated[int, msgspec.Meta(ge=2, le=100_000)] | None = None


class SweepTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [sweep] of a spec."""

    kind: Literal["grid", "random"]
    axes: dict[str, Any]
    """A list of values or a `Range` for each swept parameter."""
    rows: Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS)] | None = None
    """Size of a random sample."""
    seed: Seed | None = None
    """Seed of a random sample."""
    precision: Precision = "float32"
    """Precision of the time stepping; design and margins are always float64."""


@dataclass(frozen=True)
class SweepSpec:
    """A sweep: every controller of `space`, otherwise like `params`, on one experiment.

    Attributes:
        experiment: What the controllers meet.
        params: The base controller, which is also the baseline of the report.
        space: The swept parameters.
        precision: Of the time stepping.
        name: For people; no part of the spec's hash.
    """

    experiment: Experiment
    params: Params
    space: SweepSpace
    precision: Precision = "float32"
    name: str = "sweep"

    @staticmethod
    def from_toml(path: str | Path) -> "SweepSpec":
        """A sweep from its file; other files that it names are looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        data = read_toml(path)
        with located(path):
            return SweepSpec.from_dict(data, Path(path).parent, Path(path).stem)

    @staticmethod
    def from_dict(data: dict[str, Any], folder: Path = Path(), name: str = "sweep") -> "SweepSpec":
        """A sweep from plain data.

        Args:
            data: Keys as in the TOML file.
            folder: Where the files lie that it names.
            name: For people.

        Raises:
            InputError: A key is unknown, or a value of the wrong type or out of bounds.
        """
        known_tables(data, ("experiment", "params", "sweep"))
        if "sweep" not in data:
            raise InputError("sweep", "missing", "a table", 'Add [sweep] with kind = "grid" and [sweep.axes].')
        experiment = experiment_table(data.get("experiment", {}), folder)
        params = params_table(data.get("params", {}), folder)
        known_keys(SweepTable, data["sweep"], "sweep")
        table = convert(data["sweep"], SweepTable, "sweep")
        return SweepSpec(experiment, params, _space(table, params), table.precision, name)


def _space(table: SweepTable, params: Params) -> SweepSpace:
    if not table.axes:
        raise InputError("sweep.axes", "empty", "at least one parameter", f"Known: {', '.join(PARAMETERS)}.")
    if table.kind == "random" and table.rows is None:
        raise InputError("sweep.rows", "missing", "given for a random sweep", "Add `rows = 1000`, say.")
    for key, value in (("rows", table.rows), ("seed", table.seed)):
        if table.kind == "grid" and value is not None:
            remedy = f'Remove {key}, or set kind = "random".'
            raise InputError(f"sweep.{key}", value, "left out of a grid", remedy)
    axes = tuple(_axis(name, described, table.kind) for name, described in table.axes.items())
    horizons = (float(params.Hp), float(params.Hu))
    return make_space(table.kind, axes, table.rows or 0, table.seed or 0, horizons)


def _axis(name: str, described: Any, kind: str) -> SweepAxis:
    key = f"sweep.axes.{name}"
    if name not in PARAMETERS:
        raise InputError(key, "swept", "a known parameter", nearest(name, list(PARAMETERS)))
    if isinstance(described, list):
        for value in described:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(key, value, "a number", f"Its unit is [{PARAMETERS[name].unit}].")
        return make_axis(name, "list", tuple(map(float, described)), None)
    if not isinstance(described, dict):
        raise InputError(
            key, described, "a list or a range", "Write [1.0, 2.0], say; one value belongs under [params]."
        )
    known_keys(Range, described, key)
    described = convert(described, Range, key)
    ranges: tuple[tuple[Scale, Ends | None], ...] = (("linear", described.linear), ("log", described.log))
    given = [(scale, ends) for scale, ends in ranges if ends is not None]
    if len(given) != 1:
        raise InputError(key, "a range", "either linear or log", "Write { log = [0.01, 10.0], points = 20 }, say.")
    if (described.points is None) == (kind == "grid"):
        found, wanted = (
            ("missing", "given for a grid") if kind == "grid" else (described.points, "left out of a sample")
        )
        raise InputError(f"{key}.points", found, wanted, "A grid needs the number of points, a random sweep only rows.")
    scale, ends = given[0]
    return make_axis(name, scale, ends, described.points)
