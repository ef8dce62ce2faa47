"""One swept parameter: its values, or the range that they are drawn from."""

import math
from typing import Any, Literal

import msgspec
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import HORIZONS, PARAMETERS
from sweeps.targets import COUNTED, STRUCTURAL, target

Scale = Literal["list", "linear", "log", "choice"]
Drawn = Literal["random", "sobol"]
EXACT = 2**53
"""From here on a column, of float64, does not hold every whole number."""


class SweepAxis(msgspec.Struct, frozen=True):
    """One swept parameter.

    Attributes:
        name: A parameter of the controller or a dotted key of the experiment (`sweeps.targets`).
        scale: How its values lie: "list" are numbers that the user wrote out, "choice" is anything else (words, truth
            values, vectors, stiffness sets), and its column holds places in `values`.
        values: The points of a grid or of a list, or the two ends of a range to draw from, in the parameter's unit.
        relative: Whether a number multiplies what the base has there.
        labels: Names of the values of a choice; empty where they speak for themselves.
    """

    name: str
    scale: Scale
    values: tuple[Any, ...]
    relative: bool = False
    labels: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of its column."""
        return "-" if self.relative or self.scale == "choice" else target(self.name).unit

    @property
    def of_world(self) -> bool:
        """Whether it is a key of the experiment."""
        return target(self.name).table == "experiment"

    @property
    def numeric(self) -> bool:
        """Whether its column holds its values, not places among them."""
        return self.scale != "choice"

    @property
    def ranged(self) -> bool:
        """Whether numbers between its values are values, too."""
        return self.scale in ("linear", "log")

    def label(self, value: float) -> str:
        """An entry of its column, for people; of what counts every digit."""
        if self.numeric:
            return f"{value:.0f}" if whole(self.name) and not self.relative else f"{value:.6g}"
        return self.labels[int(value)] if self.labels else str(self.values[int(value)])

    def setting(self, value: float, base: Any) -> Any:
        """What an entry of its column sets.

        Args:
            value: The entry.
            base: What the base has there.
        """
        if not self.numeric:
            return self.values[int(value)]
        if self.relative and isinstance(base, list | tuple):
            return [value * each for each in base]
        found = value * base if self.relative else value
        # The experiment's tables tell whole numbers from others.
        return int(found) if isinstance(base, int) and found == int(found) else found

    def column(self) -> np.ndarray:
        """Its points as entries of a column, (points,)."""
        return np.asarray(self.values, np.float64) if self.numeric else np.arange(len(self.values), dtype=np.float64)

    def draw(self, uniform: np.ndarray) -> np.ndarray:
        """The entries at places in [0, 1) of the axis, (n,)."""
        if self.scale in ("list", "choice"):
            chosen: np.ndarray = self.column()[(uniform * len(self.values)).astype(int)]
            return chosen
        low, high = self.values
        if self.scale == "log":
            value = np.exp(math.log(low) + uniform * (math.log(high) - math.log(low)))
        else:
            value = low + uniform * (high - low)
        drawn: np.ndarray = np.clip(np.round(value) if whole(self.name) else value, low, high)
        return drawn


def whole(name: str) -> bool:
    """Whether a parameter counts samples or numbers something."""
    counted = (*HORIZONS, *COUNTED, "delay", "arm.substeps", "arm.encoder_counts")
    return name in counted or name.endswith(".seed")


def make_axis(
    name: str,
    scale: Scale,
    values: tuple[Any, ...],
    points: int | None,
    *,
    relative: bool = False,
    drawn: Drawn | None = None,
    seed: int = 0,
    labels: tuple[str, ...] = (),
    repeats: bool = False,
) -> SweepAxis:
    """An axis from its description in a spec.

    Args:
        name: The swept parameter.
        scale: "list" or "choice", or the spacing of a range.
        values: The list, or the two ends of the range, in the parameter's unit.
        points: Points on the range; None keeps its ends, to draw from.
        relative: Whether its numbers multiply what the base has there.
        drawn: How the points of a range are drawn, in order of size; None spaces them evenly.
        seed: Of what is drawn.
        labels: Names of the values of a choice.
        repeats: Whether a list may hold a number twice, since others advance with it.

    Raises:
        InputError: A value is not finite or out of bounds, a range is empty or of multiples of what is counted, or a
            list repeats itself.
    """
    key = f"sweep.axes.{name}"
    target(name)
    if scale in ("list", "choice"):
        if not values:
            raise InputError(key, "[]", "at least one value", "List values, or remove the axis.")
        if scale == "list":
            _check_numbers(name, scale, values, relative)
        if not (repeats and scale == "list") and len(set(map(identity, values))) != len(values):
            raise InputError(key, list(values), "free of repetition", "Each row of a sweep exists once.")
        return SweepAxis(name, scale, values, relative, labels)
    if relative and whole(name):
        remedy = "Its multiples may be no whole numbers: list them, as values = [0.5, 2.0]."
        raise InputError(f"{key}.relative", True, "left out of a range of what is counted", remedy)
    _check_numbers(name, scale, values, relative)
    first, last = values
    if not first < last:
        raise InputError(key, list(values), "[smallest, largest]", "Swap the ends of the range, or list one value.")
    axis = SweepAxis(name, scale, values, relative)
    if points is None:
        return axis
    if drawn is not None:
        spaced = np.sort(axis.draw(uniforms(drawn, points, 1, seed)[:, 0]))
    else:
        spaced = np.geomspace(first, last, points) if scale == "log" else np.linspace(first, last, points)
    # Rounding can make neighbours equal; each stays once.
    entries = dict.fromkeys((np.round(spaced) if whole(name) else spaced).tolist())
    return SweepAxis(name, scale, tuple(entries), relative)


def identity(value: Any) -> str:
    """What is the same of equal values however they are written: 1 and 1.0, 0 and −0.0, tables in any order."""
    if isinstance(value, dict):
        return repr(sorted((key, identity(each)) for key, each in value.items()))
    if isinstance(value, list | tuple):
        return repr([*map(identity, value)])
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # A negative zero and a positive one make a positive one.
    return repr(float(value) + 0.0 if number else value)


def uniforms(kind: Drawn, rows: int, dimensions: int, seed: int) -> np.ndarray:
    """Numbers in [0, 1), (rows, dimensions); a longer sample begins with the shorter one."""
    if kind == "sobol":
        # Here: it takes longer to import than a dry run may last.
        from scipy.stats import qmc

        generator = qmc.Sobol(dimensions, scramble=True, rng=np.random.Generator(np.random.Philox(seed)))
        # Always a power of two, which is what keeps a sequence balanced, and what its author warns of otherwise.
        return np.asarray(generator.random_base2(max(rows - 1, 0).bit_length()))[:rows]
    return np.random.Generator(np.random.Philox(seed)).random((rows, dimensions))


def _check_numbers(name: str, scale: Scale, values: tuple[Any, ...], relative: bool) -> None:
    """Refuse numbers that the parameter cannot take; those of the experiment's keys are checked with their tables."""
    key, row = f"sweep.axes.{name}", PARAMETERS.get(name)
    low, high = row.bounds if row and not relative else (-math.inf, math.inf)
    positive = scale == "log" or (name == "delta" and not relative)
    unit = "" if relative else f" {target(name).unit}".removesuffix(" -")
    bound = f"in [{low:g}, {high:g}]{unit}" if math.isfinite(high) else "a finite number"
    if positive:
        # One weight δ = 0 is a controller that controls nothing.
        bound = f"above 0 and at most {high:g}{unit}" if math.isfinite(high) else "a finite number above 0"
    for value in values:
        wrong = not math.isfinite(value) or not low <= value <= high or (positive and value <= 0.0)
        if wrong:
            raise InputError(key, value, bound, f"Correct the values of {name}.")
        if whole(name) and not relative:
            if value != int(value):
                raise InputError(key, value, "a whole number", f"Round the values of {name}.")
            if value >= EXACT:
                raise InputError(
                    key, value, f"a whole number below {EXACT}", "Columns of float64 do not hold larger ones."
                )


def choice_only(name: str) -> bool:
    """Whether an axis takes words or truth values alone."""
    return name in STRUCTURAL and name not in COUNTED
