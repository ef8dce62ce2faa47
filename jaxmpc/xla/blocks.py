"""Fixed-size blocks on every device of the host: a row's bits depend on nothing but the row.

A plain `jit(vmap)` on a CPU changes the bits of a row with the batch size and with the number of cores.
Blocks of one size, each a call of the same program, do not, and stay in the cache besides. The one
exception, measured: a process with a single device compiles to other last bits than one with several,
which is why the command line always makes two at least.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxmpc.xla import store
from jaxmpc.xla.shared import JitShared

BLOCK = 256
"""Controllers in a block on a CPU: below 128 the loop overhead shows, above 512 the cache does."""
GPU_BLOCK = 16384
"""Controllers in a block on a GPU: three tissues of each fill an H200, and a chunk of them its file."""


def rows_of_a_block() -> int:
    """Controllers in a block on this machine's devices."""
    return BLOCK if jax.default_backend() == "cpu" else GPU_BLOCK


class OverBlocks:
    """A compiled version of f(batch, shared) that works block by block, dealt out to all local devices.

    It takes any number of rows; the last block is padded with copies of the last row. Where an entry point keeps traced
    programs (`jaxmpc.xla.store`), a block's is one of them.
    """

    def __init__(
        self, function: Callable[..., Any], block: int = BLOCK, static: Mapping[str, Any] | None = None
    ) -> None:
        """Wrap a traceable function of a batch with leading dimension `block`, and of what all blocks share.

        Args:
            function: Of two arguments, and of what is static, by name.
            block: Rows of a block.
            static: What the function is traced for, by name.
        """
        self._block, self._dealt = block, OverDevices(function, static)

    def begin(self, batch: Any, shared: Any) -> Callable[[], Any]:
        """Have the devices begin; what is returned waits for them, and gives the result as numpy.

        They are called once for a block on each: of a loop over several, XLA makes another program, with other bits.
        """
        width, rows = self._block * jax.local_device_count(), len(jax.tree.leaves(batch)[0])
        whole = padded(batch, width)
        shared = self._dealt.everywhere(jax.tree.map(jnp.asarray, shared))
        begun = [
            self._dealt.begin(jax.tree.map(lambda leaf, first=first: leaf[first : first + width], whole), shared)
            for first in range(0, rows, width)
        ]
        return lambda: jax.tree.map(lambda *parts: np.concatenate(parts)[:rows], *(finish() for finish in begun))

    def __call__(self, batch: Any, shared: Any) -> Any:
        """What the function returns for every row, as numpy."""
        return self.begin(batch, shared)()


class OverDevices:
    """A compiled version of f(batch, shared) whose rows are dealt out to all local devices.

    It takes any number of rows: where the devices cannot share them, copies of the last row fill up, and do not come
    back. Where an entry point keeps traced programs (`jaxmpc.xla.store`), that of a device's share is one of them.
    """

    def __init__(self, function: Callable[..., Any], static: Mapping[str, Any] | None = None) -> None:
        """Wrap a traceable function of a batch of any number of rows, of what all share, and of what is static."""
        mesh = Mesh(np.array(jax.local_devices()), ("device",))
        spec: Any = PartitionSpec
        split, whole = spec("device"), spec()
        self._devices, self._everywhere = mesh.size, NamedSharding(mesh, whole)
        self._there: dict[int, tuple[jax.Array, Any]] = {}

        def dealt(batch: Any, shared: Any) -> Callable[..., Any]:
            share = jax.tree.map(lambda leaf: leaf[: len(leaf) // self._devices], batch)
            run = store.kept_or_plain(function, static or {}, share, shared)
            specs = {"in_specs": (split, whole), "out_specs": split}
            return jax.shard_map(run, mesh=mesh, check_vma=False, **specs)

        self._dealt = JitShared(dealt)

    def everywhere(self, shared: Any) -> Any:
        """What all rows share, on every device; arrays of the call before are there already.

        Many calls in a row share the same, and to have it looked at by JAX takes as long as a small program.
        """
        leaves, tree = jax.tree.flatten(shared)
        there = self._there
        new = [leaf for leaf in leaves if id(leaf) not in there]
        put = iter(jax.device_put(new, self._everywhere))
        placed = [there[id(leaf)][1] if id(leaf) in there else next(put) for leaf in leaves]
        # With the arrays themselves, or another might have the place of one in memory; others than JAX's may change.
        self._there = {
            id(leaf): (leaf, at) for leaf, at in zip(leaves, placed, strict=True) if isinstance(leaf, jax.Array)
        }
        return jax.tree.unflatten(tree, placed)

    def compile(self, batch: Any, shared: Any) -> None:
        """Compile for arrays like these before there is anything to run with."""
        self._dealt.compile(padded(batch, self._devices), self.everywhere(shared))

    def launched(self, batch: Any, shared: Any, left: Any = None) -> Any:
        """The result as it is on the devices, which go on working at it; of a batch that was filled up, all rows.

        Args:
            batch: The rows.
            shared: What all share.
            left: What such a call has left on the devices of the same rows, for which nothing is waited: the last part
                of the batch. None is nothing.
        """
        rows = padded(batch, self._devices)
        return self._dealt(rows if left is None else (*rows, left), self.everywhere(shared))

    def begin(self, batch: Any, shared: Any) -> Callable[[], Any]:
        """Have the devices begin; what is returned waits for them, and gives the result as numpy."""
        rows, found = len(jax.tree.leaves(batch)[0]), self.launched(batch, shared)
        return lambda: fetched(found, rows)

    def __call__(self, batch: Any, shared: Any) -> Any:
        """What the function returns for every row, as numpy."""
        return self.begin(batch, shared)()

    @property
    def programs(self) -> int:
        """How many programs it has compiled."""
        return self._dealt.programs


def padded(batch: Any, multiple: int) -> Any:
    """A batch filled up with copies of its last row to a multiple of a number of rows."""
    missing = -len(jax.tree.leaves(batch)[0]) % multiple

    def fill(leaf: Any) -> Any:
        leaf = np.asarray(leaf)
        return np.concatenate([leaf, np.repeat(leaf[-1:], missing, axis=0)])

    return jax.tree.map(fill, batch)


def fetched(found: Any, rows: int) -> Any:
    """So many rows of what is on the devices, as numpy: all of it is sent for before any is waited for."""
    return jax.tree.map(lambda leaf: leaf[:rows], jax.device_get(found))
