"""Episodes in a kernel, differentiable in forward mode by the constants of their lanes.

`jax.jvp` runs one kernel that yields value and tangent. Under `jax.vmap` over directions alone, as `jax.jacfwd` has it,
one kernel takes all of them, so many to a program (`Shape.directions`), beside one run that they share; where slopes
of little are wanted, a run of that alone.
"""

from math import nan
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero

from jaxmpc.engine.episode import Episode
from jaxmpc.engine.lane_ops import lane_ops
from jaxmpc.engine.lanes import Track, at_sample, packed, recorded
from jaxmpc.engine.pallas_triton import NOWHERE, Directions, Shape, run_episodes
from jaxmpc.engine.pruned import pruned
from jaxmpc.engine.tangents import only

FEW = 3
"""Leaves that slopes are wanted of, so few that programs of several directions leave out what others are made of."""


class Program(NamedTuple):
    """What a kernel is made of; hashable."""

    episode: Episode
    shape: tuple[int, int, int]
    """Groups, tissues, controllers."""
    dtype: Any
    alone: Shape
    """How it is cut where nothing is differentiated."""
    along: Shape
    """And where something is."""
    interpret: bool
    wanted: tuple[bool, ...]
    """Which leaves that are left have slopes where something is differentiated; the others' are NaN."""


def episodes(program: Program, lane: Any, signals: Any) -> Any:
    """What is left of each lane's episode; leaves (groups, tissues, controllers).

    Args:
        program: What is run.
        lane: Constants, which broadcast against the shape; what the derivative is by.
        signals: Leaves (groups, steps, …); not differentiated.

    Raises:
        TypeError: Signals have a tangent.
    """
    return _episodes(program, *jax.tree.map(jnp.asarray, (lane, signals)))


def _alone(program: Program, lane: Any, signals: Any) -> Any:
    return _run(program, lane, signals, (), [])[0]


_episodes: Any = jax.custom_jvp(_alone, nondiff_argnums=(0,))


def _jvp(program: Program, primals: Any, tangents: Any) -> tuple[Any, Any]:
    lane, signals = primals
    by_lane, by_signals = (jax.tree.leaves(each, is_leaf=_is_zero) for each in tangents)
    if not all(map(_is_zero, by_signals)):
        raise TypeError(
            "The kernel differentiates by controllers, tissues and robot, not by signals (heart, noise, wanted force): "
            'take the engine "scan".'
        )
    moving = tuple(not _is_zero(slope) for slope in by_lane)
    left, slopes = _one_direction(program, moving)(lane, signals, only(moving, by_lane))
    leaves, tree = jax.tree.flatten(left)
    full = [
        jnp.full_like(leaf, 0.0 if wanted else nan) if slope is None else slope
        for leaf, slope, wanted in zip(leaves, slopes, program.wanted, strict=True)
    ]
    return left, jax.tree.unflatten(tree, full)


_episodes.defjvp(_jvp, symbolic_zeros=True)


def _is_zero(slope: Any) -> bool:
    return isinstance(slope, SymbolicZero)


def _one_direction(program: Program, moving: tuple[bool, ...]) -> Any:
    """f(lane, signals, tangents of what moves) → what is left and its tangents; several at once share the run."""

    @custom_vmap
    def one(lane: Any, signals: Any, slopes: list[Any]) -> Any:
        left, found = _run(program, lane, signals, moving, [slope[None] for slope in slopes])
        return left, jax.tree.map(lambda leaf: leaf[0], found)

    @one.def_vmap
    def several(size: int, batched: Any, lane: Any, signals: Any, slopes: list[Any]) -> Any:
        if any(jax.tree.leaves(batched[:2])):
            # Nothing is shared.
            every = jax.tree.map(
                lambda leaf, is_batched: leaf if is_batched else jnp.broadcast_to(leaf, (size, *leaf.shape)),
                (lane, signals, slopes),
                tuple(batched),
            )
            found = jax.lax.map(lambda each: one(*each), every)
            return found, jax.tree.map(lambda _: True, found)
        each = [
            slope if is_batched else jnp.broadcast_to(slope, (size, *slope.shape))
            for slope, is_batched in zip(slopes, batched[2], strict=True)
        ]
        left, found = _run(program, lane, signals, moving, each)
        return (left, found), (jax.tree.map(lambda _: False, left), jax.tree.map(lambda _: True, found))

    return one


def _run(program: Program, lane: Any, signals: Any, moving: tuple[bool, ...], slopes: list[Any]) -> tuple[Any, Any]:
    """Along every direction: tangents (directions, …) of the leaves that move."""
    shape, precision = program.shape, jnp.dtype(program.dtype)
    constants, layout = packed(lane, shape, precision)
    row, track = recorded(signals, precision)
    cut, along, count = program.alone, NOWHERE, len(slopes[0]) if slopes else 0
    if count:
        together = min(program.along.directions, count)
        cut, filled = program.along._replace(directions=together), -count % together
        wide = [jnp.pad(slope, ((0, filled), *((0, 0),) * (slope.ndim - 1))) for slope in slopes]
        _, own = packed(only(moving, jax.tree.leaves(lane)), shape, precision)
        arrays = jax.vmap(lambda leaves: packed(leaves, shape, precision)[0])(wide)
        along = Directions(moving, program.wanted, own, tuple(map(jnp.ravel, arrays)), count + filled)
    ops = lane_ops(precision)

    def run(episode: Episode, cut: Shape, along: Directions) -> tuple[Any, list[Any]]:
        left, found = run_episodes(episode, layout, track, ops, cut, constants, row, along, interpret=program.interpret)
        return left, [None if leaf is None else leaf[:count] for leaf in found]

    if cut.directions < 2 or not 0 < sum(program.wanted) <= FEW:
        return run(program.episode, cut, along)
    # What nobody differentiates comes from a run of its own, which the compiler leaves out if nobody looks at it.
    wanted = program.wanted
    episode = pruned(program.episode, wanted, *_of_one(program, lane, row, track), ops)
    some, found = run(episode, cut, along._replace(wanted=(True,) * sum(wanted)))
    leaves, tree = jax.tree.flatten(run(program.episode, program.alone, NOWHERE)[0])
    for i, place in enumerate(place for place, each in enumerate(wanted) if each):
        leaves[place] = some[i]
    there = iter(found)
    return jax.tree.unflatten(tree, leaves), [next(there) if each else None for each in wanted]


def _of_one(program: Program, lane: Any, row: Any, track: Track) -> tuple[Any, Any]:
    """Shapes of the constants of one lane, and of the signals of a sample."""
    zero = jnp.zeros((), row.dtype)
    one = jax.tree.map(lambda _: zero, lane)
    return one, jax.eval_shape(lambda row: program.episode.taken_apart(at_sample(track, row, 0, 0)), row)
