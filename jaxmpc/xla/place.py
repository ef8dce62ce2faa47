"""Where programs run: a CPU is done with a few loops before a GPU, which takes one small step after another, begins."""

from contextlib import AbstractContextManager
from typing import Any

import jax


def on_cpu() -> AbstractContextManager[Any]:
    """Within it, in this thread, programs run on the CPU, whatever else there is."""
    context: AbstractContextManager[Any] = jax.default_device(jax.local_devices(backend="cpu")[0])
    return context


def platform() -> str:
    """Kind of the device on which a program would run that this thread starts now: "cpu", "gpu"."""
    chosen: Any = jax.config.jax_default_device
    if chosen is None:
        return jax.default_backend()
    return chosen if isinstance(chosen, str) else str(chosen.platform)
