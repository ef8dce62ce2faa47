"""Lanes of a batch as flat arrays: what many cells share is stored once, and each lane finds what is its own.

A batch has three dimensions, (groups, tissues, controllers): a group shares its signals (a motion of the arm, an axis
of the linear loop), and its tissues × controllers are its lanes. A leaf of a lane's constants that is the same along a
dimension has length 1 there.
"""

from itertools import product
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

Varying = tuple[bool, ...]
"""Along which of the three dimensions a leaf varies."""
KINDS: tuple[Varying, ...] = tuple(product((False, True), repeat=3))


class Layout(NamedTuple):
    """Where each leaf lies; hashable."""

    tree: Any
    """Structure of a lane's constants."""
    shape: tuple[int, int, int]
    """Groups, tissues, controllers."""
    places: tuple[tuple[int, int], ...]
    """Per leaf its kind, a place in `KINDS`, and its row in the array of that kind."""
    rows: tuple[int, ...]
    """How many leaves there are of each kind."""


def packed(lane: Any, shape: tuple[int, int, int], dtype: Any) -> tuple[tuple[Any, ...], Layout]:
    """Constants as one flat array per kind that occurs, and where each leaf is.

    Args:
        lane: Leaves broadcast against the shape, as numpy does.
        shape: Groups, tissues, controllers.
        dtype: Of the arrays.
    """
    leaves, tree = jax.tree.flatten(lane)
    kinds: list[list[Any]] = [[] for _ in KINDS]
    places = []
    for leaf in leaves:
        whole = jnp.reshape(leaf, (1,) * (3 - jnp.ndim(leaf)) + jnp.shape(leaf))
        varies = tuple(there > 1 for there in whole.shape)
        kind = KINDS.index(varies)
        places.append((kind, len(kinds[kind])))
        kinds[kind].append(jnp.ravel(whole).astype(dtype))
    arrays = tuple(jnp.concatenate(rows) for rows in kinds if rows)
    return arrays, Layout(tree, shape, tuple(places), tuple(map(len, kinds)))


def unpacked(layout: Layout, arrays: Any, group: Any, lane: Any, copy: Any = 0) -> Any:
    """The constants of some lanes of a group.

    Args:
        layout: Of the arrays.
        arrays: The flat arrays, indexable by an integer or several.
        group: Which one.
        lane: Which of its lanes, one integer or several.
        copy: Which, where each array holds several one behind the other.
    """
    controllers = layout.shape[2]
    own = group, lane // controllers, lane % controllers
    there = iter(arrays)
    by_kind: list[list[Any]] = []
    for varies, rows in zip(KINDS, layout.rows, strict=True):
        lengths = [n for n, along in zip(layout.shape, varies, strict=True) if along]
        size = behind = prod(lengths)
        place: Any = copy * rows * size
        for index, length in zip((own[i] for i in range(3) if varies[i]), lengths, strict=True):
            behind //= length
            place = place + index * behind
        by_kind.append(_read(next(there), place, size, rows) if rows else [])
    return jax.tree.unflatten(layout.tree, [by_kind[kind][row] for kind, row in layout.places])


def _read(array: Any, place: Any, size: int, rows: int) -> list[Any]:
    """Numbers of every row of an array, each so many behind the last; of several lanes in a loop (`each_in_turn`)."""
    if jnp.ndim(place) == 0:
        return [array[place + row * size] for row in range(rows)]

    def one(row: Any, found: list[Any]) -> list[Any]:
        value = array[place + row * size]
        return [jnp.where(row == i, value, other) for i, other in enumerate(found)]

    nothing = jnp.zeros(jnp.shape(place), array.dtype)
    found: list[Any] = each_in_turn(rows, one, [nothing] * rows)
    return found


def each_in_turn(rows: int, one: Any, state: Any) -> Any:
    """The state after f(row, state) of every row, in a loop that has one access to memory instead of one a row.

    Triton looks at all of a program for each access that it holds (its pass "coalesce", jax 0.11): a hundred of them
    took the arm's kernel 31 of the 32 seconds in which it was compiled.
    """
    return jax.lax.fori_loop(jnp.int32(0), jnp.int32(rows), one, state)


class Track(NamedTuple):
    """How the signals of a sample lie in one row; hashable."""

    tree: Any
    shapes: tuple[tuple[int, ...], ...]
    """What each leaf has at one sample."""
    flags: tuple[bool, ...]
    """Which leaves are truth values."""
    steps: int
    width: int
    """Numbers of a sample."""


def recorded(signals: Any, dtype: Any) -> tuple[Any, Track]:
    """Signals as one flat array, groups × steps × numbers of a sample, and how they lie.

    Args:
        signals: Leaves (groups, steps, …).
        dtype: Of the array.
    """
    leaves, tree = jax.tree.flatten(signals)
    groups, steps = leaves[0].shape[:2]
    columns = [jnp.reshape(leaf, (groups, steps, -1)).astype(dtype) for leaf in leaves]
    flags = tuple(leaf.dtype == bool for leaf in leaves)
    array = jnp.concatenate(columns, axis=-1)
    track = Track(tree, tuple(leaf.shape[2:] for leaf in leaves), flags, steps, array.shape[-1])
    return jnp.ravel(array), track


def at_sample(track: Track, array: Any, group: Any, step: Any) -> Any:
    """The signals of a sample: scalars, and for each dimension of a leaf a tuple."""
    begin, leaves, column = (group * track.steps + step) * track.width, [], 0
    for shape, flag in zip(track.shapes, track.flags, strict=True):
        values = [array[begin + column + i] for i in range(prod(shape))]
        column += len(values)
        leaves.append(_nested([value > 0 for value in values] if flag else values, shape))
    return jax.tree.unflatten(track.tree, leaves)


def _nested(values: list[Any], shape: tuple[int, ...]) -> Any:
    if not shape:
        return values[0]
    size = len(values) // shape[0]
    return tuple(_nested(values[i * size : (i + 1) * size], shape[1:]) for i in range(shape[0]))
