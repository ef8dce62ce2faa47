"""Forward mode inside a kernel: what a function's inputs move of its outputs, and by how much along some directions.

The derivative is JAX's own, of the very function that is run: it is linearised once, at a value that all directions
share, and each direction then costs the linear part alone. Leaves that nothing moves have no tangent, and so neither a
register nor an instruction.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

# See `jaxmpc.xla.cse` of what JAX promises.
from jax.extend.core import Literal

FLAT = {"floor", "ceil", "round", "sign", "stop_gradient"}
"""Primitives without slope."""


def moved(closed: Any, inputs: Sequence[bool]) -> tuple[bool, ...]:
    """Which outputs of a program move when some inputs do; never too few.

    A number that is no float never moves, nor does anything times a written zero: the form of a finite number is not
    its value.

    Args:
        closed: The program, a closed jaxpr.
        inputs: Which of its inputs move.
    """
    jaxpr = closed.jaxpr
    moving = {var for var, moves in zip(jaxpr.invars, inputs, strict=True) if moves}

    def is_moving(var: Any) -> bool:
        return not isinstance(var, Literal) and var in moving

    for equation in jaxpr.eqns:
        name = equation.primitive.name
        vanishes = name == "mul" and any(isinstance(var, Literal) and var.val == 0.0 for var in equation.invars)
        if name not in FLAT and not vanishes and any(map(is_moving, equation.invars)):
            moving.update(var for var in equation.outvars if jnp.issubdtype(var.aval.dtype, jnp.floating))
    return tuple(map(is_moving, jaxpr.outvars))


def movable(
    begin: Any, one: Any, fold: Any, found: Any, own: Sequence[bool], lane: Any, now: Any
) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
    """Which leaves of what is carried, and of what is left, ever move with the constants of a lane.

    Args:
        begin: f(lane) → what is carried.
        one: f(lane, carried, now) → carried.
        fold: f(lane, carried) → carried.
        found: f(carried) → what is left.
        own: Which leaves of a lane move.
        lane: Shapes of one.
        now: Shapes of a sample's signals.
    """
    run = jax.eval_shape(begin, lane)
    still = (False,) * len(jax.tree.leaves(now))
    moves = moved(jax.make_jaxpr(begin)(lane), own)
    stepping, folding = jax.make_jaxpr(one)(lane, run, now), jax.make_jaxpr(fold)(lane, run)
    while True:
        stepped = moved(stepping, (*own, *moves, *still))
        folded = moved(folding, (*own, *moves))
        more = tuple(map(any, zip(moves, stepped, folded, strict=True)))
        if more == moves:
            return moves, moved(jax.make_jaxpr(found)(run), moves)
        moves = more


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
