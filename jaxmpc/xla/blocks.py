"""Fixed-size blocks on every device of the host: a row's bits depend on nothing but the row.

A plain `jit(vmap)` on a CPU changes the bits of a row with the batch size and with the number of cores.
Blocks of one size, each a call of the same program, do not, and stay in the cache besides. The one
exception, measured: a process with a single device compiles to other last bits than one with several,
which is why the command line always makes two at least.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

BLOCK = 256
"""Controllers in a block: below 128 the loop overhead shows, above 512 the cache does."""


def over_blocks(function: Callable[..., Any], block: int = BLOCK) -> Callable[..., Any]:
    """A compiled version of f(batch, shared) that works block by block, dealt out to all local devices.

    Args:
        function: Takes a batch with leading dimension `block`, and what all blocks share; traceable.
        block: Rows of one block.

    Returns:
        A function of the same arguments for any number of rows; the last block is padded with copies of
        the last row. One compilation per number of blocks.
    """
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("device",))
    spec: Any = PartitionSpec
    split, whole = spec("device"), spec()

    def on_device(blocks: Any, shared: Any) -> Any:
        return jax.lax.map(lambda one: function(one, shared), blocks)

    dealt = jax.jit(jax.shard_map(on_device, mesh=mesh, in_specs=(split, whole), out_specs=split, check_vma=False))

    def run(batch: Any, shared: Any) -> Any:
        rows = len(jax.tree.leaves(batch)[0])
        per_round = block * len(devices)
        missing = -rows % per_round

        def deal(leaf: Any) -> Any:
            leaf = np.asarray(leaf)
            padded = np.concatenate([leaf, np.repeat(leaf[-1:], missing, axis=0)])
            return padded.reshape(-1, block, *leaf.shape[1:])

        done = dealt(jax.tree.map(deal, batch), jax.tree.map(jnp.asarray, shared))
        return jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *leaf.shape[2:])[:rows], done)

    return run
