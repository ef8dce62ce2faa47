"""Where programs run: a CPU is done with a few loops before a GPU, which takes one small step after another, begins."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import Any, TypeVar

import jax
import numpy as np

Tree = TypeVar("Tree")


@contextmanager
def on_cpu() -> Iterator[None]:
    """Within it, in this thread, programs run on the CPU, whatever else there is; `@on_cpu()` does so to a function."""
    # Where they do so anyway, a device by name would have them all traced again.
    with nullcontext() if platform() == "cpu" else jax.default_device(jax.local_devices(backend="cpu")[0]):
        yield


def platform() -> str:
    """Kind of the device on which a program would run that this thread starts now: "cpu", "gpu"."""
    chosen: Any = jax.config.jax_default_device
    if chosen is None:
        return jax.default_backend()
    return chosen if isinstance(chosen, str) else str(chosen.platform)


def placed(tree: Tree) -> Tree:
    """A tree's arrays where programs run; `jnp.asarray`, which says the same, compiles a program for each shape.

    They are copies: JAX may share numpy's memory or read it later, and somebody may change it.
    """
    own = jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, tree)
    there: Tree = jax.device_put(own)
    return there


def wake() -> None:
    """Have the device hold a first array, before which a GPU takes seconds to begin: for a thread beside the rest."""
    jax.device_put(np.zeros(())).block_until_ready()


def wake_beside() -> None:
    """The same in a thread of its own, for entry points, as soon as devices are chosen.

    A device that cannot begin is heard of by who computes first.
    """

    def woken() -> None:
        with suppress(Exception):
            wake()

    threading.Thread(target=woken, daemon=True).start()
