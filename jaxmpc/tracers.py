"""Processes that trace programs for this one, where a GPU has cores to spare.

Tracing is Python: of threads that trace one gets on at a time, and makes late whatever else Python does meanwhile. A
process with the same devices traces the same program, and leaves it among the kept ones (`jaxmpc.xla.store`).
"""

import inspect
import os
from collections.abc import Callable
from contextlib import nullcontext, suppress
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.beside import heard, spoken_with
from jaxmpc.terminal.process import may_have_a_gpu, use_all_cores
from jaxmpc.xla import store
from jaxmpc.xla.place import on_cpu, platform, wake_beside

MOST, CORES = 4, 4
"""Most processes that trace, and how many cores are there for each: what they have traced is compiled beside them."""


def trace_apart(module: str) -> None:
    """Have processes trace what this one will run, where it may have a GPU and has cores to spare.

    For entry points, after `jaxmpc.terminal.process.use_all_cores`: they have the same devices.

    Args:
        module: Of the first program, which they import meanwhile.
    """
    processes, folder = min(MOST, len(os.sched_getaffinity(0)) // CORES), store.kept_in()
    if processes and folder and may_have_a_gpu():
        store.trace_with(Tracers(processes, folder, module))


class Order(NamedTuple):
    """A program to trace."""

    name: str
    """That of its file."""
    module: str
    function: str
    """Its name in the module."""
    arguments: dict[str, Any]
    """By name, shapes and types in the place of arrays."""
    static: dict[str, Any]
    wide: bool
    """Whether a float is a double there."""
    on_cpu: bool


class Tracers:
    """Some processes; they end with this one, however that ends."""

    def __init__(self, processes: int, folder: Path, module: str = __name__) -> None:
        """Have them begin, which takes them seconds.

        Args:
            processes: How many.
            folder: Where programs are kept.
            module: What they import before they are asked, or whoever asks first waits for that.
        """
        self.folder, self._idle = folder, SimpleQueue[Connection]()
        for _ in range(processes):
            self._idle.put(spoken_with(_serve, folder, module)[1])

    def __call__(
        self, name: str, function: Callable[..., Any], arguments: dict[str, Any], static: dict[str, Any]
    ) -> bool:
        """Wait until one of them has traced a program, and kept it if files can be written, or could not.

        Args:
            name: That of its file (`jaxmpc.xla.store.name_of`).
            function: Called as function(**arguments, **static).
            arguments: The arrays, by name.
            static: The rest, by name.

        Returns:
            Whether it has traced the program.
        """
        module, own = function.__module__, function.__qualname__
        if _found(module, own) is not function:
            return False
        shapes = jax.tree.map(_shape, arguments)
        order = Order(name, module, own, shapes, static, jnp.result_type(float) == np.float64, platform() == "cpu")
        tracer = self._idle.get()
        try:
            # Of any type: what cannot be sent, or whom nobody answers any more, is traced by who has asked.
            with suppress(Exception):
                tracer.send(order)
                return bool(heard(tracer))
            return False
        finally:
            self._idle.put(tracer)


def _serve(orders: Connection, folder: Path, module: str) -> None:
    # Of any type: a GPU may take no further process, or a source have changed. Who has asked then traces, and tells.
    with suppress(Exception):
        use_all_cores()
        store.keep_in(folder)
        wake_beside()
        import_module(module)
        while True:
            orders.send(_traced(orders.recv()))


def _traced(order: Order) -> bool:
    """Whether the program is kept now: only what has the name here that it has there is the same program."""
    function = _found(order.module, order.function)
    with jax.enable_x64(order.wide), on_cpu() if order.on_cpu else nullcontext():
        same = store.name_of(function, order.arguments, order.static) == order.name
        return same and store.program(order.name, function, order.arguments, order.static) is not None


def _found(module: str, name: str) -> Any:
    """What a module calls so, without what compiles it around it."""
    found: Any = import_module(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return inspect.unwrap(found) if callable(found) else found


def _shape(leaf: Any) -> Any:
    kind: Any = jax.typeof(leaf)
    of_kind: Any = jax.ShapeDtypeStruct
    return of_kind(kind.shape, kind.dtype, weak_type=kind.weak_type)
