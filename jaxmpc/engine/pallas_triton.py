"""Whole episodes in one kernel: all that depends on Pallas and its Triton backend.

Each program of the grid keeps the state of `LANES` lanes in registers for all of an episode, reads the signals once per
sample and writes what is left at the end.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.experimental import pallas
from jax.experimental.pallas import triton

from jaxmpc.engine.episode import STRETCH, Episode
from jaxmpc.engine.fewer_operations import Inverses, lean
from jaxmpc.engine.lanes import Layout, Track, at_sample, unpacked
from jaxmpc.law.ops import Ops


class Shape(NamedTuple):
    """How a kernel is cut; hashable."""

    lanes: int
    """Lanes of one program, a power of two."""
    warps: int


def run_episodes(
    episode: Episode,
    layout: Layout,
    track: Track,
    ops: Ops,
    cut: Shape,
    constants: tuple[Any, ...],
    signals: Any,
    *,
    interpret: bool,
) -> Any:
    """What is left of each lane's episode; leaves (groups, tissues, controllers).

    Args:
        episode: What is run.
        layout: Of the constants.
        track: Of the signals.
        ops: Scalar functions that Triton knows.
        cut: Lanes and warps of a program.
        constants: One array per kind.
        signals: All groups' in one array.
        interpret: Run it without a GPU, which is slow.

    Raises:
        ValueError: There is more of something than 32 bits can count.
    """
    groups, tissues, controllers = layout.shape
    count, dtype = tissues * controllers, signals.dtype
    blocks = pallas.cdiv(count, cut.lanes)
    scalar: Any = jax.eval_shape(lambda: jnp.zeros(cut.lanes, dtype))
    quick = not interpret and dtype == jnp.float32

    def begin(lane: Any) -> Any:
        return _as_lanes(episode.begin(lane, ops), scalar)

    def one(lane: Any, run: Any, now: Any) -> Any:
        return episode.step(lane, run, now, ops)[0]

    def kernel(*refs: Any) -> None:
        *constant, signal, out = refs
        group, block = pallas.program_id(1), pallas.program_id(0)
        lane = block * cut.lanes + jnp.arange(cut.lanes, dtype=jnp.int32)
        own = unpacked(layout, constant, group, jnp.minimum(lane, count - 1))

        def step(i: Any, run: Any) -> Any:
            now = episode.taken_apart(at_sample(track, signal, group, i))
            following = lean(one, Inverses(_reciprocal, _root), own, run, now) if quick else one(own, run, now)
            return _as_lanes(following, scalar)

        def stretch(k: Any, run: Any) -> Any:
            first = k * STRETCH
            run = jax.lax.fori_loop(first, jnp.minimum(first + STRETCH, track.steps), step, run)
            return _as_lanes(episode.fold(own, run, ops), scalar)

        stretches = -(-track.steps // STRETCH)
        run = jax.lax.fori_loop(jnp.int32(0), jnp.int32(stretches), stretch, begin(own))
        for row, value in enumerate(jax.tree.leaves(_as_lanes(episode.found(run), scalar))):
            start = ((row * groups + group) * blocks + block) * cut.lanes
            out[pallas.ds(start, cut.lanes)] = value

    like = jax.eval_shape(
        lambda *arrays: episode.found(begin(unpacked(layout, arrays, 0, jnp.zeros(cut.lanes, jnp.int32)))), *constants
    )
    rows = len(jax.tree.leaves(like))
    most = max(rows * groups * blocks * cut.lanes, signals.size, *(array.size for array in constants))
    if most >= 2**31:
        raise ValueError(f"{most} numbers in an array of a kernel, which counts to 2³¹: run fewer controllers")
    call = pallas.pallas_call(
        kernel,
        out_shape=jax.eval_shape(lambda: jnp.zeros(rows * groups * blocks * cut.lanes, dtype)),
        grid=(blocks, groups),
        compiler_params=triton.CompilerParams(num_warps=cut.warps, num_stages=1),
        interpret=interpret,
        name="episodes",
    )
    found = call(*constants, signals).reshape(rows, groups, blocks * cut.lanes)[:, :, :count]
    leaves = found.reshape(rows, groups, tissues, controllers)
    return jax.tree.unflatten(jax.tree.structure(like), list(leaves))


def _as_lanes(tree: Any, like: Any) -> Any:
    """Every number as one per lane: a loop wants the same form before and after."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, like.dtype), like.shape), tree)


def _reciprocal(value: Any) -> Any:
    """1/x, whose last bit is the processor's: one instruction instead of eight."""
    return (1.0 / value).astype(value.dtype) if jnp.ndim(value) == 0 else _instruction("rcp", value)


def _root(value: Any) -> Any:
    """√x likewise."""
    return jnp.sqrt(value) if jnp.ndim(value) == 0 else _instruction("sqrt", value)


def _instruction(name: str, value: Any) -> Any:
    (found,) = triton.elementwise_inline_asm(
        f"{name}.approx.ftz.f32 $0, $1;",
        args=[value],
        constraints="=f,f",
        pack=1,
        result_shape_dtypes=[jax.typeof(value)],
    )
    return found
