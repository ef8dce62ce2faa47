"""Whole episodes in one kernel: all that depends on Pallas and its Triton backend.

Each program of the grid keeps the state of `LANES` lanes in registers for all of an episode, reads the signals once per
sample and writes what is left at the end.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.experimental import pallas
from jax.experimental.pallas import triton

from jaxmpc.engine.episode import STRETCH, Episode
from jaxmpc.engine.fewer_operations import Instructions, lean
from jaxmpc.engine.lane_ops import plainly_fused
from jaxmpc.engine.lanes import Layout, Track, at_sample, each_in_turn, unpacked
from jaxmpc.engine.tangents import movable, only, pushed
from jaxmpc.law.ops import Ops


class Shape(NamedTuple):
    """How a kernel is cut; hashable."""

    lanes: int
    """Lanes of one program, a power of two."""
    warps: int
    directions: int = 0
    """Directions that one program differentiates along, beside one run that they share; 0 is the run alone."""
    samples: int = 1
    """Samples written out one behind the other, a divisor of `STRETCH`; one by one where steps are no multiple."""


class Directions(NamedTuple):
    """What the constants are differentiated along."""

    moving: tuple[bool, ...]
    """Which of their leaves move."""
    wanted: tuple[bool, ...]
    """Which leaves that are left have tangents, if they move."""
    layout: Layout
    """Where those lie."""
    arrays: tuple[Any, ...]
    """Tangents, one direction behind the other: a multiple of `Shape.directions`."""
    size: int
    """How many directions."""


NOWHERE = Directions((), (), Layout(None, (0, 0, 0), (), ()), (), 0)


def run_episodes(
    episode: Episode,
    layout: Layout,
    track: Track,
    ops: Ops,
    cut: Shape,
    constants: tuple[Any, ...],
    signals: Any,
    along: Directions = NOWHERE,
    *,
    interpret: bool,
) -> tuple[Any, Any]:
    """What is left of each lane's episode, and its tangents.

    Args:
        episode: What is run.
        layout: Of the constants.
        track: Of the signals.
        ops: Scalar functions that Triton knows.
        cut: Lanes, warps and directions of a program.
        constants: One array per kind.
        signals: All groups' in one array.
        along: What to differentiate along.
        interpret: Run it without a GPU, which is slow.

    Returns:
        What is left, leaves (groups, tissues, controllers); and along directions the tangent of each leaf with these in
        front, None where nothing moves it, or nobody wants it.

    Raises:
        ValueError: There is more of something than 32 bits can count.
    """
    groups, tissues, controllers = layout.shape
    count, dtype = tissues * controllers, signals.dtype
    blocks = pallas.cdiv(count, cut.lanes)
    scalar: Any = jax.eval_shape(lambda: jnp.zeros(cut.lanes, dtype))
    processor = _PLAIN if interpret else _INSTRUCTIONS[jnp.dtype(dtype)]
    parts = along.size // cut.directions if along.size else 1
    together = 1 if track.steps % cut.samples else cut.samples

    def begin(lane: Any) -> Any:
        return _as_lanes(episode.begin(lane, ops), scalar)

    def one(lane: Any, run: Any, now: Any) -> Any:
        return _as_lanes(episode.step(lane, run, now, ops)[0], scalar)

    def fold(lane: Any, run: Any) -> Any:
        return _as_lanes(episode.fold(lane, run, ops), scalar)

    def found(run: Any) -> Any:
        return _as_lanes(episode.found(run), scalar)

    def moved_on(function: Any, own: Any, own_slopes: Any, state: Any) -> Any:
        """f(lane, carried), and along each direction what moves of it."""
        run, slopes = state
        joined = [[*mine, *its] for mine, its in zip(own_slopes, slopes, strict=True)]
        run, after = pushed(function, (own, run), (*along.moving, *moves), joined)
        return run, [only(moves, each) for each in after]

    example = jax.eval_shape(lambda *arrays: unpacked(layout, arrays, 0, jnp.zeros(cut.lanes, jnp.int32)), *constants)
    like = jax.eval_shape(lambda lane: found(begin(lane)), example)
    moves: tuple[bool, ...] = ()
    found_moves: tuple[bool, ...] = ()
    if along.size:
        met = jax.eval_shape(lambda array: episode.taken_apart(at_sample(track, array, 0, 0)), signals)
        moves, found_moves = movable(begin, one, fold, found, along.moving, example, met, along.wanted)

    def kernel(*refs: Any) -> None:
        constant, tangent = refs[: len(constants)], refs[len(constants) : -2]
        signal, out = refs[-2:]
        part, group, block = pallas.program_id(2), pallas.program_id(1), pallas.program_id(0)
        lane = jnp.minimum(block * cut.lanes + jnp.arange(cut.lanes, dtype=jnp.int32), count - 1)
        own = unpacked(layout, constant, group, lane)
        first = part * cut.directions
        own_slopes = [unpacked(along.layout, tangent, group, lane, first + i) for i in range(cut.directions)]

        def step(i: Any, state: Any) -> Any:
            now = episode.taken_apart(at_sample(track, signal, group, i))

            def following(constant: tuple[Any, Any], state: Any, now: Any) -> Any:
                return moved_on(lambda own, run: one(own, run, now), constant[0], constant[1], state)

            given = (own, own_slopes), state, now
            return _as_lanes(lean(following, processor, *given, values=len(jax.tree.leaves(state[0]))), scalar)

        def steps(i: Any, state: Any) -> Any:
            for j in range(together):
                state = step(i * together + j, state)
            return state

        def stretch(k: Any, state: Any) -> Any:
            first, after = k * STRETCH, jnp.minimum((k + 1) * STRETCH, track.steps)
            state = jax.lax.fori_loop(first // together, after // together, steps, state)
            return _as_lanes(moved_on(fold, own, own_slopes, state), scalar)

        begun, slopes = pushed(begin, (own,), along.moving, own_slopes)
        state = _as_lanes((begun, [only(moves, each) for each in slopes]), scalar)
        stretches = -(-track.steps // STRETCH)
        run, slopes = jax.lax.fori_loop(jnp.int32(0), jnp.int32(stretches), stretch, state)
        left, after = pushed(found, (run,), moves, slopes)
        values = [*jax.tree.leaves(left), *(slope for each in after for slope in only(found_moves, each))]
        values = _as_lanes(values, scalar)

        def write(row: Any, state: Any) -> Any:
            start = (((part * rows + row) * groups + group) * blocks + block) * cut.lanes
            chosen = values[0]
            for i, value in enumerate(values[1:], 1):
                chosen = jnp.where(row == i, value, chosen)
            out[pallas.ds(start, cut.lanes)] = chosen
            return state

        each_in_turn(rows, write, ())

    leaves, tree = jax.tree.flatten(like)
    rows = len(leaves) + cut.directions * sum(found_moves)
    size = parts * rows * groups * blocks * cut.lanes
    most = max(size, signals.size, *(array.size for array in (*constants, *along.arrays)))
    if most >= 2**31:
        raise ValueError(f"{most} numbers in an array of a kernel, which counts to 2³¹: run fewer controllers")
    call = pallas.pallas_call(
        kernel,
        out_shape=jax.eval_shape(lambda: jnp.zeros(size, dtype)),
        grid=(blocks, groups, parts),
        compiler_params=triton.CompilerParams(num_warps=cut.warps, num_stages=1),
        interpret=interpret,
        name="episodes",
    )
    flat = call(*constants, *along.arrays, signals).reshape(parts, rows, groups, blocks * cut.lanes)[..., :count]
    values = flat.reshape(parts, rows, groups, tissues, controllers)
    slopes = values[:, len(leaves) :].reshape(along.size, sum(found_moves), groups, tissues, controllers)
    there = iter(jnp.moveaxis(slopes, 1, 0))
    tangents = [next(there) if each else None for each in found_moves or [False] * len(leaves)]
    return jax.tree.unflatten(tree, list(values[0, : len(leaves)])), tangents


def _as_lanes(tree: Any, like: Any) -> Any:
    """Every number as one per lane: a loop wants the same form before and after."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, like.dtype), like.shape), tree)


def _exact(value: Any) -> Any:
    return (1.0 / value).astype(value.dtype)


def _reciprocal(value: Any) -> Any:
    """1/x, whose last bit is the processor's: one instruction instead of eight."""
    return _exact(value) if jnp.ndim(value) == 0 else _instruction("rcp.approx.ftz.f32", value)


def _root(value: Any) -> Any:
    """√x likewise."""
    return jnp.sqrt(value) if jnp.ndim(value) == 0 else _instruction("sqrt.approx.ftz.f32", value)


def _fused(dtype: Any, one: Any, other: Any, rest: Any) -> Any:
    """a·b + c in one instruction: JAX has no name for it, and this compiler joins no two by itself."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, (one, other, rest)))
    if not shape:
        return plainly_fused(one, other, rest)
    name = f"fma.rn.f{8 * jnp.dtype(dtype).itemsize}"
    return _instruction(name, *(jnp.broadcast_to(jnp.asarray(each, dtype), shape) for each in (one, other, rest)))


def _instruction(name: str, *values: Any) -> Any:
    places = ", ".join(f"${i}" for i in range(len(values) + 1))
    register = "f" if name.endswith("f32") else "d"
    (found,) = triton.elementwise_inline_asm(
        f"{name} {places};",
        args=list(values),
        constraints=",".join([f"={register}", *(register for _ in values)]),
        pack=1,
        result_shape_dtypes=[jax.typeof(values[0])],
    )
    return found


_PLAIN = Instructions(_exact, jnp.sqrt, plainly_fused)
_INSTRUCTIONS = {
    jnp.dtype(jnp.float32): Instructions(_reciprocal, _root, partial(_fused, jnp.float32)),
    jnp.dtype(jnp.float64): Instructions(_exact, jnp.sqrt, partial(_fused, jnp.float64)),
}
"""In float64 there is none for a reciprocal or a root to the last bits."""
