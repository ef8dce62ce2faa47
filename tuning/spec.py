"""What to tune, as a TOML file: experiment, starting point, free parameters, goals."""

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from jaxmpc.errors import InputError, nearest
from jaxmpc.experiment import Experiment
from jaxmpc.job import experiment_table, params_table
from jaxmpc.params import BOUNDS, DIAGONALS, Params
from jaxmpc.sealed import digest
from jaxmpc.spec import convert, known_keys, located, read_toml
from jaxmpc.world.motion import Seed
from tuning.goals import UNITS
from tuning.transforms import FREE, HORIZONS, Space, axis_of

Bounds = tuple[float, float]
Count = Annotated[int, msgspec.Meta(ge=1, le=100_000)]


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [tune]."""

    steps: Count = 150
    """Gradient steps at most: half with soft horizons, half polishing."""
    starts: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 8
    """The given parameters and random ones."""
    seed: Seed = 0
    """Draws the random starts."""
    train_seeds: tuple[Seed, ...] = (0, 1)
    """Motion seeds that the tuner sees."""
    heldout_seeds: tuple[Seed, ...] = tuple(range(1000, 1020))
    """Motion seeds that only the final comparison sees."""
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 6.0
    """Length of a training run [s]; held-out runs have the experiment's own."""
    settle: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 1.5
    """What is left out of its residual at the start [s]."""
    learning_rate: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.15
    """Of Adam, in units of the parameters' scales."""
    precision: Literal["float64", "float32"] = "float64"
    """Of the time stepping. Float64 is also the faster one on a CPU: adjoints of float32 end in subnormals."""
    diagonals: tuple[Literal["lam", "delta"], ...] = ()
    """Free parameters of which each diagonal entry is tuned by itself."""


class TuneSpec(msgspec.Struct, frozen=True, dict=True):
    """A tuning job; `from_toml`, or built in Python.

    Raises:
        InputError: Names key, value, bound and remedy.
    """

    experiment: Experiment
    params: Params
    """Where the first start stands, and the values of what is frozen."""
    tune: Settings = Settings()
    free: Mapping[str, Bounds | None] = msgspec.field(default_factory=lambda: dict.fromkeys(FREE))
    """Free parameters and their bounds; None takes the default ones."""
    goals: Mapping[str, float] = msgspec.field(default_factory=lambda: {"M_s": 2.0})
    """Limits of the margins, held at every stiffness of the experiment."""
    ideal: bool = False
    """Whether margins are those of the ideal loop, or of the loop as it runs."""

    def __post_init__(self) -> None:
        _check_split(self.tune)
        _check_goals(self.goals)
        if self.tune.settle >= self.tune.duration:
            remedy = "Lower settle or raise duration."
            raise InputError("tune.settle", self.tune.settle, f"below duration (= {self.tune.duration:g} s)", remedy)
        if self.params.batch_shape:
            raise InputError("params", f"a batch {self.params.batch_shape}", "one controller", "Give one start point.")
        if not self.free:
            raise InputError("tune.free", "empty", "at least one parameter", f"Free by default: {', '.join(FREE)}.")
        for name, bounds in self.free.items():
            _check_bounds(name, bounds, self.params)
        for name in self.tune.diagonals:
            if name not in self.free:
                raise InputError("tune.diagonals", name, "a free parameter", f"Add `{name} = true` to [tune.free].")
        for name in DIAGONALS:
            if name in self.free and name not in self.tune.diagonals and getattr(self.params, name).ndim:
                remedy = f'Add "{name}" to tune.diagonals, or start from one number.'
                raise InputError(f"params.{name}", "a diagonal", "one number to be tuned as one", remedy)

    @cached_property
    def space(self) -> Space:
        """The free parameters as one vector."""
        axes = [axis_of(name, bounds, name in self.tune.diagonals) for name, bounds in self.free.items()]
        return Space(self.params, axes)

    @cached_property
    def digest(self) -> str:
        """Hash of the whole job, all defaults written out."""
        return digest(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Plain data, every default written out."""
        free = {axis.name: [axis.low, axis.high] for axis in self.space.axes}
        return {
            "experiment": self.experiment.to_dict(),
            "params": self.params.to_dict(),
            "tune": {**msgspec.to_builtins(self.tune), "free": free},
            "goals": {**self.goals, "ideal": self.ideal},
        }

    @staticmethod
    def from_toml(path: str | Path) -> "TuneSpec":
        """A job from its file; files that it names are looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        data = read_toml(path)
        with located(path):
            return TuneSpec.from_dict(data, Path(path).parent)

    @staticmethod
    def from_dict(data: Mapping[str, Any], folder: Path = Path()) -> "TuneSpec":
        """A job from plain data, as the TOML file has it.

        Args:
            data: Tables experiment, params, tune, goals; each may be left out.
            folder: Where files that it names lie.

        Raises:
            InputError: Names key, value, bound and remedy.
        """
        tables = ("experiment", "params", "tune", "goals")
        for name, table in data.items():
            if name not in tables:
                raise InputError(name, table, "a known table", nearest(name, list(tables)))
            if not isinstance(table, dict):
                raise InputError(name, table, "a table", f"Put its keys under [{name}].")
        tune, goals = dict(data.get("tune", {})), dict(data.get("goals", {}))
        free = _free(tune.pop("free", dict.fromkeys(FREE, True)))
        known_keys(Settings, tune, "tune")
        ideal = goals.pop("ideal", False)
        if not isinstance(ideal, bool):
            raise InputError("goals.ideal", ideal, "true or false", "True judges the paper's ideal damping.")
        return TuneSpec(
            experiment=experiment_table(data.get("experiment", {}), folder),
            params=params_table(data.get("params", {}), folder),
            tune=convert(tune, Settings, "tune"),
            free=free,
            goals=goals or {"M_s": 2.0},
            ideal=ideal,
        )


def _free(table: Any) -> dict[str, Bounds | None]:
    if not isinstance(table, dict):
        raise InputError("tune.free", table, "a table", "Write `[tune.free]` and one line per parameter.")
    free: dict[str, Bounds | None] = {}
    for name, value in table.items():
        numbers = isinstance(value, list) and all(type(x) in (int, float) for x in value)
        if not (value is True or (numbers and len(value) == 2)):
            remedy = "Leave a frozen parameter out; `true` takes the default bounds."
            raise InputError(f"tune.free.{name}", value, "[lowest, highest] or true", remedy)
        free[name] = None if value is True else (value[0], value[1])
    return free


def _check_split(tune: Settings) -> None:
    for key, seeds in (("train_seeds", tune.train_seeds), ("heldout_seeds", tune.heldout_seeds)):
        if not seeds:
            raise InputError(f"tune.{key}", "[]", "at least one motion seed", "Give some, such as [1000, 1001].")
        if len(set(seeds)) < len(seeds):
            raise InputError(f"tune.{key}", list(seeds), "without repetition", "Name each seed once.")
    if common := sorted(set(tune.train_seeds) & set(tune.heldout_seeds)):
        remedy = "A seed that the tuner has seen proves nothing; remove it from one list."
        raise InputError("tune.heldout_seeds", common[0], "unknown to train_seeds", remedy)


def _check_goals(goals: Mapping[str, Any]) -> None:
    for name, limit in goals.items():
        if name not in UNITS:
            raise InputError(f"goals.{name}", limit, "a known goal", nearest(name, [*UNITS, "ideal"]))
        low = 1.0 if name == "M_s" else 0.0
        number = isinstance(limit, int | float) and not isinstance(limit, bool)
        if not (number and low < limit < math.inf):
            raise InputError(f"goals.{name}", limit, f"a number above {low:g} {UNITS[name]}".strip(), "Give a limit.")


def _check_bounds(name: str, bounds: Bounds | None, params: Params) -> None:
    if name not in BOUNDS:
        raise InputError(f"tune.free.{name}", bounds or "true", "a known parameter", nearest(name, list(BOUNDS)))
    low, high, unit = BOUNDS[name]
    axis = axis_of(name, bounds, False)
    for value in (axis.low, axis.high):
        if not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"tune.free.{name}", value, f"in [{low:g}, {high:g}] {unit}", "Move this bound inside.")
    if axis.low >= axis.high:
        raise InputError(f"tune.free.{name}", list(bounds or ()), "[lowest, highest]", "Exchange or part the bounds.")
    if name in HORIZONS and (axis.low % 1 or axis.high % 1):
        raise InputError(f"tune.free.{name}", list(bounds or ()), "whole numbers of samples", "Round them.")
    start = getattr(params, name)
    if (start < axis.low).any() or (start > axis.high).any():
        remedy = f"The start {start:g} lies outside: move it, or widen the bounds."
        raise InputError(f"tune.free.{name}", [axis.low, axis.high], "around the start point", remedy)
