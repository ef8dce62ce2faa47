"""An episode that carries only what some of its results are made of."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxmpc.engine.episode import Episode
from jaxmpc.engine.tangents import Moves, closed_under, only, sources
from jaxmpc.law.ops import Ops


class Pruned(NamedTuple):
    """What is carried and what is left are tuples of leaves; hashable, as an `Episode` is."""

    episode: Episode
    carries: Any
    """Structure of what the whole one carries."""
    carried: Moves
    """Which of its leaves are."""
    left: Moves
    """Which leaves of what it leaves are."""

    def taken_apart(self, now: Any) -> Any:
        """See `Episode`."""
        return self.episode.taken_apart(now)

    def begin(self, lane: Any, ops: Ops) -> Any:
        """See `Episode`."""
        return self._kept(self.episode.begin(lane, ops))

    def step(self, lane: Any, run: Any, now: Any, ops: Ops) -> tuple[Any, Any]:
        """See `Episode`."""
        following, sample = self.episode.step(lane, self._whole(run), now, ops)
        return self._kept(following), sample

    def fold(self, lane: Any, run: Any, ops: Ops) -> Any:
        """See `Episode`."""
        return self._kept(self.episode.fold(lane, self._whole(run), ops))

    def found(self, run: Any) -> Any:
        """See `Episode`."""
        return tuple(only(self.left, jax.tree.leaves(self.episode.found(self._whole(run)))))

    def _kept(self, run: Any) -> Any:
        return tuple(only(self.carried, jax.tree.leaves(run)))

    def _whole(self, run: Any) -> Any:
        """With something in the place of what nothing that is left is made of."""
        there, nothing = iter(run), jnp.zeros_like(run[0])
        return jax.tree.unflatten(self.carries, [next(there) if kept else nothing for kept in self.carried])


def pruned(episode: Episode, left: Sequence[bool], lane: Any, now: Any, ops: Ops) -> Pruned:
    """An episode with no more than what some leaves of what it leaves are made of.

    Args:
        episode: The whole one.
        left: Which leaves.
        lane: Shapes of the constants of one.
        now: Shapes of a sample's signals, taken apart.
        ops: Scalar functions.
    """
    run = jax.eval_shape(lambda lane: episode.begin(lane, ops), lane)
    own, size = len(jax.tree.leaves(lane)), len(jax.tree.leaves(run))
    stepping = jax.make_jaxpr(lambda lane, run, now: episode.step(lane, run, now, ops)[0])(lane, run, now)
    folding = jax.make_jaxpr(lambda lane, run: episode.fold(lane, run, ops))(lane, run)

    def earlier(needed: Moves) -> list[Moves]:
        return [sources(program, needed)[own:][:size] for program in (stepping, folding)]

    needed = closed_under(earlier, sources(jax.make_jaxpr(episode.found)(run), left))
    return Pruned(episode, jax.tree.structure(run), needed, tuple(left))
