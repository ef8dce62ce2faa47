"""From the tables of a sweep's file to its axes."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.toml import convert, known_keys
from jaxmpc.quantities import HORIZONS, PARAMETERS
from jaxmpc.synthesis.params import Params
from sweeps.axis import Scale, SweepAxis, choice_only, identity, make_axis
from sweeps.rows import meetings, world_of
from sweeps.space import Factor, SpaceKind, SweepSpace, make_space
from sweeps.tables import RANGE_KEYS, Ends, Range, SweepTable
from sweeps.targets import RECORDING, TABLES, numbered, read, target

STIFFNESS_SETS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {"paper": (375.0, 810.0, 1900.0), "family": (375.0, 550.0, 810.0, 1250.0, 1900.0)}
)
"""Stiffness sets by name [N/m]: the paper's foams, and the knots of the published family."""

LENGTHS = ("duration", "settle", "reference", "sampling_time")
"""Keys of the experiment that decide which samples count."""
MOST_CHECKED, MOST_LISTED = 64, 10_000
"""Points of a factor that are tried before anything runs, and of one whose values are all written out."""


def stiffness_set(name: str, own: Mapping[str, Any], key: str) -> tuple[float, ...]:
    """A stiffness set by its name [N/m].

    Raises:
        InputError: There is none of this name.
    """
    known = {**STIFFNESS_SETS, **own}
    if name not in known:
        raise InputError(key, name, "a stiffness set", nearest(name, list(known)))
    return tuple(map(float, known[name]))


def read_space(table: SweepTable, params: Params, experiment: Experiment, folder: Path = Path()) -> SweepSpace:
    """The points that a table describes; recordings are looked for in the folder.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    if not table.axes and not table.zip:
        raise InputError("sweep.axes", "empty", "at least one parameter", f"Known: {', '.join(PARAMETERS)}, …")
    if table.kind != "grid" and table.rows is None:
        raise InputError("sweep.rows", "missing", "given for a sample", "Add `rows = 1000`, say.")
    for key, value in (("rows", table.rows), ("seed", table.seed)):
        if table.kind == "grid" and value is not None:
            remedy = f'Remove {key}, or set kind = "random".'
            raise InputError(f"sweep.{key}", value, "left out of a grid", remedy)
    own, kind = table.stiffness_sets, table.kind
    factors: list[Factor] = [
        (_axis(name, _beside(name, each, folder), kind, own),) for name, each in flattened(table.axes)
    ]
    for group in table.zip:
        axes = tuple(
            _axis(name, _beside(name, each, folder), kind, own, repeats=True) for name, each in flattened(group)
        )
        if len(axes) < 2:
            raise InputError("sweep.zip", list(group), "two axes or more", "Write a single axis under [sweep.axes].")
        # Axes of unequal length are refused later on, or drawn from.
        points = Counter(zip(*(map(identity, axis.values) for axis in axes), strict=False))
        point, times = points.most_common(1)[0]
        if times > 1:
            raise InputError("sweep.zip", ", ".join(point), "free of repetition", "Each row of a sweep exists once.")
        factors.append(axes)
    _check_bases(factors, params, experiment)
    check_worlds(factors, experiment)
    for each in [*([factor] for factor in factors), factors]:
        _check_controllers(each, params)
    horizons = (float(params.Hp), float(params.Hu))
    return make_space(table.kind, tuple(factors), table.rows or 0, table.seed or 0, horizons)


def _beside(name: str, described: Any, folder: Path) -> Any:
    """The same axis; recordings are looked for in a folder."""
    if name != RECORDING:
        return described
    if isinstance(described, dict):
        return {key: _beside(name, value, folder) if key == "values" else value for key, value in described.items()}
    if isinstance(described, list):
        return [str(folder / file) if isinstance(file, str) else file for file in described]
    return described


def flattened(axes: Mapping[str, Any], root: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names of axes: `arm.cable_hz = […]` is a table in a table to TOML."""
    for name, described in axes.items():
        # None of these is an axis itself, and motion has a key that a range has, too: its seed.
        if isinstance(described, dict) and f"{root}{name}" in TABLES:
            yield from flattened(described, f"{root}{name}.")
        elif isinstance(described, dict) and _of_entries(described, nested=bool(root)):
            yield from flattened(described, f"{root}{name}.")
        else:
            yield f"{root}{name}", described


def _of_entries(described: Mapping[str, Any], *, nested: bool) -> bool:
    """Whether a table is no range but has axes of its own: `stiffness.1` is an entry of a key outside the tables."""
    return bool(described) and (all(map(numbered, described)) or (nested and not set(described) & RANGE_KEYS))


def _axis(name: str, described: Any, kind: SpaceKind, sets: Mapping[str, Any], *, repeats: bool = False) -> SweepAxis:
    key = f"sweep.axes.{name}"
    target(name)
    if isinstance(described, list):
        return _listed(name, described, Range(), sets, repeats)
    if not isinstance(described, dict):
        raise InputError(
            key, described, "a list or a range", "Write [1.0, 2.0], say; one value belongs under [params]."
        )
    known_keys(Range, described, key)
    given = convert(described, Range, key)
    if given.relative and (choice_only(name) or name in HORIZONS):
        why = "It counts samples: list them." if name in HORIZONS else "It has no values in between."
        raise InputError(f"{key}.relative", True, "left out", why)
    if given.seed is not None and given.draw is None:
        remedy = 'Add draw = "random", or remove the seed; that of a sample stands in [sweep].'
        raise InputError(f"{key}.seed", given.seed, "given with draw", remedy)
    if given.values is not None:
        if given.linear or given.log or given.points or given.draw:
            raise InputError(key, "values and a range", "one of the two", "Remove the range.")
        return _listed(name, given.values, given, sets, repeats)
    ranges: tuple[tuple[Scale, Ends | None], ...] = (("linear", given.linear), ("log", given.log))
    spaced = [(scale, ends) for scale, ends in ranges if ends is not None]
    if len(spaced) != 1:
        raise InputError(key, "a range", "either linear or log", "Write { log = [0.01, 10.0], points = 20 }, say.")
    if (given.points is None) == (kind == "grid"):
        found = "missing" if kind == "grid" else given.points
        wanted = "given for a grid" if kind == "grid" else "left out of a sample"
        raise InputError(f"{key}.points", found, wanted, "A grid needs the number of points, a sample only rows.")
    if given.draw is not None and kind != "grid":
        raise InputError(f"{key}.draw", given.draw, "left out of a sample", "A sample draws every range.")
    if choice_only(name):
        raise InputError(key, "a range", "a list", "It has no values in between.")
    scale, ends = spaced[0]
    return make_axis(name, scale, ends, given.points, relative=given.relative, drawn=given.draw, seed=given.seed or 0)


def _listed(name: str, values: list[Any], given: Range, sets: Mapping[str, Any], repeats: bool) -> SweepAxis:
    key = f"sweep.axes.{name}"
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if numbers and not choice_only(name):
        return make_axis(name, "list", tuple(map(float, values)), None, relative=given.relative, repeats=repeats)
    vectors = name not in HORIZONS and all(isinstance(value, list) for value in values)
    if given.relative or (name in PARAMETERS and not vectors):
        wrong = next(each for each in values if isinstance(each, bool) or not isinstance(each, int | float))
        raise InputError(key, wrong, "a number", f"Its unit is [{target(name).unit}].")
    labels: tuple[str, ...] = ()
    if name == "stiffness":
        labels = tuple(value if isinstance(value, str) else str(value) for value in values)
        values = [stiffness_set(value, sets, key) if isinstance(value, str) else value for value in values]
        lengths = {len(value) if isinstance(value, list | tuple) else 1 for value in values}
        if len(lengths) > 1:
            raise InputError(key, f"{sorted(lengths)} tissues", "sets of one length", "A result has one shape.")
        values = [value if isinstance(value, list | tuple) else [value] for value in values]
    return make_axis(name, "choice", tuple(_frozen(value) for value in values), None, labels=labels)


def _frozen(value: Any) -> Any:
    return tuple(_frozen(each) for each in value) if isinstance(value, list) else value


def _points(
    factors: Sequence[Factor], wanted: Callable[[SweepAxis], bool]
) -> Iterator[tuple[Factor, tuple[float, ...]]]:
    """Axes that are wanted, and their entries at some points of what the factors multiply to, its ends among them."""
    kept = [tuple(axis for axis in factor if wanted(axis)) for factor in factors]
    kept = [factor for factor in kept if factor]
    if not kept:
        return
    shape = [min(len(axis.column()) for axis in factor) for factor in kept]
    count = math.prod(shape)
    written_out = len(kept) == 1 and all(axis.scale in ("list", "choice") for axis in kept[0])
    most = MOST_LISTED if written_out else MOST_CHECKED
    for i in sorted({round(place) for place in np.linspace(0, count - 1, min(count, most))}):
        places = np.unravel_index(i, shape)
        entries = [(axis, float(axis.column()[k])) for factor, k in zip(kept, places, strict=True) for axis in factor]
        yield tuple(axis for axis, _ in entries), tuple(entry for _, entry in entries)


def check_worlds(factors: Sequence[Factor], experiment: Experiment) -> None:
    """Refuse points of the space that make no experiment with the base, or one whose runs would score nothing.

    Raises:
        InputError: Names axis, value, bound and remedy.
    """
    data = experiment.to_dict()
    for each in [*([factor] for factor in factors), factors]:
        for axes, entries in _points(each, lambda axis: axis.of_world):
            with _told_of(axes, entries):
                Experiment.from_dict(world_of(data, axes, entries))
    if any(axis.name.startswith(LENGTHS) for factor in factors for axis in factor):
        for axes, entries in _points(factors, lambda axis: axis.of_world):
            with _told_of(axes, entries):
                _ = Experiment.from_dict(world_of(data, axes, entries)).scored


def _check_controllers(factors: list[Factor], params: Params) -> None:
    """Refuse points of factors that make no controller with the base; horizons that cross are left out of a sweep."""
    params = replace(params, Hu=1)
    for axes, entries in _points(factors, lambda axis: not axis.of_world and axis.name != "Hu"):
        columns = {axis.name: np.array([entry]) for axis, entry in zip(axes, entries, strict=True)}
        with _told_of(axes, entries):
            list(meetings(params, axes, columns, by_world=False))


@contextmanager
def _told_of(axes: Factor, entries: tuple[float, ...]) -> Iterator[None]:
    """Tell what is wrong of the axis that it comes from."""
    try:
        yield
    except InputError as error:
        key = error.key.removeprefix("params.")
        # Of pairs: an axis whose values are tables has no hash.
        found = [*zip(axes, entries, strict=True)]
        axis, entry = next((pair for pair in found if key.startswith(pair[0].name)), found[0])
        remedy = f"It makes {error.key} = {error.value}. {error.remedy}" if axis.relative else error.remedy
        raise InputError(f"sweep.axes.{axis.name}", axis.label(entry), error.bound, remedy) from None


def _check_bases(factors: list[Factor], params: Params, experiment: Experiment) -> None:
    """Refuse axes that are relative to nothing, or an entry of a vector that is none."""
    data = experiment.to_dict()
    for axis in (axis for factor in factors for axis in factor):
        base = read(axis.name, params, data)
        numbers = base if isinstance(base, list | tuple) else [base]
        if axis.relative and not all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers):
            remedy = "Give the base a number there, or leave `relative` out."
            raise InputError(f"sweep.axes.{axis.name}", base, "a number to multiply", remedy)
        if axis.relative and not any(numbers):
            remedy = "Times nothing is nothing in every row: give the base a number there, or leave `relative` out."
            raise InputError(f"sweep.axes.{axis.name}", base, "a number other than 0 to multiply", remedy)
