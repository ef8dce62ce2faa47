"""Forward mode inside a kernel: what a function's inputs move of its outputs, and by how much along some directions.

The derivative is JAX's own, of the very function that is run: it is linearised once, at a value that all directions
share, and each direction then costs the linear part alone. Leaves that nothing moves have no tangent, and so neither a
register nor an instruction; nor have those that move nothing of what is wanted.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

# See `jaxmpc.xla.cse` of what JAX promises.
from jax.extend.core import Literal

Moves = tuple[bool, ...]
"""Which of some leaves move, or move others."""
FLAT = {"floor", "ceil", "round", "sign", "stop_gradient"}
"""Primitives without slope."""


def moved(closed: Any, inputs: Sequence[bool]) -> Moves:
    """Which outputs of a program move when some inputs do; never too few.

    A number that is no float never moves, nor does anything times a written zero: the form of a finite number is not
    its value.

    Args:
        closed: The program, a closed jaxpr.
        inputs: Which of its inputs move.
    """
    jaxpr = closed.jaxpr
    moving = {var for var, moves in zip(jaxpr.invars, inputs, strict=True) if moves}
    for equation in jaxpr.eqns:
        if _has_slope(equation) and moving.intersection(_numbers(equation.invars)):
            moving.update(_numbers(equation.outvars))
    return tuple(not isinstance(var, Literal) and var in moving for var in jaxpr.outvars)


def movers(closed: Any, outputs: Sequence[bool]) -> Moves:
    """Which inputs of a program move some of its outputs, likewise.

    Args:
        closed: The program, a closed jaxpr.
        outputs: Which of its outputs are meant.
    """
    jaxpr = closed.jaxpr
    moving = set(_numbers(var for var, meant in zip(jaxpr.outvars, outputs, strict=True) if meant))
    for equation in reversed(jaxpr.eqns):
        if _has_slope(equation) and moving.intersection(equation.outvars):
            moving.update(_numbers(equation.invars))
    return tuple(var in moving for var in jaxpr.invars)


def sources(closed: Any, outputs: Sequence[bool]) -> Moves:
    """Which inputs of a program some of its outputs are made of, by a choice alone too; arguments as for `movers`."""
    jaxpr = closed.jaxpr
    needed = {var for var, meant in zip(jaxpr.outvars, outputs, strict=True) if meant and not isinstance(var, Literal)}
    for equation in reversed(jaxpr.eqns):
        if needed.intersection(equation.outvars):
            needed.update(var for var in equation.invars if not isinstance(var, Literal))
    return tuple(var in needed for var in jaxpr.invars)


def _numbers(places: Iterable[Any]) -> list[Any]:
    """Variables that are numbers with fractions."""
    return [var for var in places if not isinstance(var, Literal) and jnp.issubdtype(var.aval.dtype, jnp.floating)]


def _has_slope(equation: Any) -> bool:
    name = equation.primitive.name
    vanishes = name == "mul" and any(isinstance(var, Literal) and var.val == 0.0 for var in equation.invars)
    return name not in FLAT and not vanishes


def movable(
    begin: Any, one: Any, fold: Any, found: Any, own: Sequence[bool], lane: Any, now: Any, wanted: Sequence[bool]
) -> tuple[Moves, Moves]:
    """Which leaves of what is carried, and of what is left, need a tangent.

    A leaf that is left needs one if it is wanted and ever moves with the constants of a lane; one that is carried, if
    it moves with them and in the end moves what is wanted.

    Args:
        begin: f(lane) → what is carried.
        one: f(lane, carried, now) → carried.
        fold: f(lane, carried) → carried.
        found: f(carried) → what is left.
        own: Which leaves of a lane move.
        lane: Shapes of one.
        now: Shapes of a sample's signals.
        wanted: Of which leaves that are left tangents are wanted.
    """
    run = jax.eval_shape(begin, lane)
    size, still = len(jax.tree.leaves(run)), (False,) * len(jax.tree.leaves(now))
    stepping, folding = jax.make_jaxpr(one)(lane, run, now), jax.make_jaxpr(fold)(lane, run)
    ending = jax.make_jaxpr(found)(run)

    def later(moves: Moves) -> list[Moves]:
        return [moved(stepping, (*own, *moves, *still)), moved(folding, (*own, *moves))]

    def earlier(moves: Moves) -> list[Moves]:
        return [movers(program, moves)[len(own) :][:size] for program in (stepping, folding)]

    moves = closed_under(later, moved(jax.make_jaxpr(begin)(lane), own))
    ends = tuple(map(all, zip(moved(ending, moves), wanted, strict=True)))
    matters = closed_under(earlier, movers(ending, ends))
    return tuple(map(all, zip(moves, matters, strict=True))), ends


def closed_under(more: Callable[[Moves], list[Moves]], moves: Moves) -> Moves:
    """What some leaves come to move, or are moved by, over any number of samples; `more` tells it of one."""
    while True:
        after = tuple(map(any, zip(moves, *more(moves), strict=True)))
        if after == moves:
            return moves
        moves = after


def pushed(
    function: Callable[..., Any], arguments: Any, moving: Sequence[bool], directions: Sequence[Sequence[Any]]
) -> tuple[Any, list[list[Any]]]:
    """f(…), and along each direction the tangents of all its leaves.

    Args:
        function: Traceable, of floating leaves alone.
        arguments: A tuple.
        moving: Which of their leaves have tangents.
        directions: For each, the tangents of those leaves; none costs nothing.
    """
    if not directions:
        return function(*arguments), []
    leaves, tree = jax.tree.flatten(arguments)

    def of_moving(*live: Any) -> Any:
        there = iter(live)
        return function(
            *jax.tree.unflatten(tree, [next(there) if m else x for x, m in zip(leaves, moving, strict=True)])
        )

    found, slope = jax.linearize(of_moving, *only(moving, leaves))
    return found, [jax.tree.leaves(slope(*each)) for each in directions]


def only(moving: Sequence[bool], leaves: Sequence[Any]) -> list[Any]:
    """The leaves that move."""
    return [leaf for leaf, moves in zip(leaves, moving, strict=True) if moves]
