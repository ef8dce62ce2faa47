"""From rows to what is run: controllers, and the world that each of them meets."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.synthesis.params import Params
from sweeps.axis import SweepAxis
from sweeps.targets import STRUCTURAL, changed, read


class Meeting(NamedTuple):
    """Controllers of one structure, and the worlds that they meet."""

    places: np.ndarray
    """Where its rows stand among those that were asked for."""
    params: Params
    """A batch."""
    worlds: np.ndarray
    """Entries of the axes that change the world, (rows, axes)."""


def meetings(
    base: Params, axes: tuple[SweepAxis, ...], columns: Mapping[str, np.ndarray], *, by_world: bool
) -> Iterator[Meeting]:
    """Rows gathered by the controller's structure.

    Args:
        base: The base controller.
        axes: What is swept.
        columns: An entry per axis and row.
        by_world: Whether to gather them by world as well, so that each meeting has one.
    """
    apart = [axis.name for axis in axes if axis.name in STRUCTURAL or (by_world and axis.of_world)]
    count = len(next(iter(columns.values())))
    groups = [np.arange(count)]
    if apart:
        keys = np.stack([columns[name] for name in apart], axis=1)
        found, which = np.unique(keys, axis=0, return_inverse=True)
        groups = [np.flatnonzero(which.ravel() == i) for i in range(len(found))]
    of_world = [axis.name for axis in axes if axis.of_world]
    for places in groups:
        own = {name: values[places] for name, values in columns.items()}
        structure = {
            axis.name: axis.setting(float(own[axis.name][0]), getattr(base, axis.name))
            for axis in axes
            if axis.name in STRUCTURAL
        }
        params = Params.from_dict({**base.to_dict(), **structure}) if structure else base
        worlds = np.stack([own[name] for name in of_world], axis=1) if of_world else np.zeros((len(places), 0))
        yield Meeting(places, _batch(params, axes, own), worlds)


def _batch(base: Params, axes: tuple[SweepAxis, ...], columns: Mapping[str, np.ndarray]) -> Params:
    """Controllers of one structure."""
    given: dict[str, Any] = {}
    for axis in axes:
        if axis.of_world or axis.name in STRUCTURAL:
            continue
        entries = columns[axis.name]
        if axis.relative:
            own = np.asarray(getattr(base, axis.name))
            given[axis.name] = entries.reshape(-1, *(1,) * own.ndim) * own
        elif axis.numeric:
            given[axis.name] = entries
        else:
            each = [getattr(Params.from_dict({axis.name: list(value)}), axis.name) for value in axis.values]
            given[axis.name] = np.stack(each)[entries.astype(int)]
    # Where the world alone is swept, every row has the base controller.
    count = len(next(iter(columns.values())))
    return base.with_columns(given or {"K2": np.broadcast_to(base.K2, (count,))})


def world_of(experiment: Mapping[str, Any], axes: tuple[SweepAxis, ...], entries: tuple[float, ...]) -> dict[str, Any]:
    """Plain data of the experiment that a row meets.

    Args:
        experiment: The base's.
        axes: What is swept.
        entries: Of those axes that change the world.
    """
    changes: dict[str, Any] = {}
    of_world = (axis for axis in axes if axis.of_world)
    for axis, entry in zip(of_world, entries, strict=True):
        value = axis.setting(entry, read(axis.name, Params(), experiment))
        changes[axis.name] = [value] if axis.name == "stiffness" and axis.numeric and not axis.relative else value
    return changed(experiment, changes)


def stiffness_met(
    experiment: Mapping[str, Any], axes: tuple[SweepAxis, ...], columns: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Stiffnesses that rows met where they are swept, (rows, stiffness) [N/m].

    Args:
        experiment: The base's.
        axes: What is swept.
        columns: An entry per axis and row.
    """
    worlds = np.stack([columns[axis.name] for axis in axes if axis.of_world], axis=1)
    found, which = np.unique(worlds, axis=0, return_inverse=True)
    sets = [world_of(experiment, axes, tuple(entries))["stiffness"] for entries in found.tolist()]
    return np.asarray(sets, float)[which.ravel()]


def experiment_of(data: Mapping[str, Any]) -> Experiment:
    """The experiment of plain data.

    Raises:
        InputError: It is none: a value is out of bounds, or does not go with the others.
    """
    return Experiment.from_dict(dict(data))
