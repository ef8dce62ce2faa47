"""A compiled function that several threads call: the first compiles it, and the others wait instead of doing so too.

For programs that run many times: unlike `jaxmpc.xla.once.JitOnce` it compiles with all optimisations.
"""

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any

import jax


class JitShared:
    """`jax.jit` for several threads, which may be compiled before there is anything to run it with.

    A program of arrays of one kind runs on the devices that it was compiled for, wherever the arrays are by default.
    """

    def __init__(self, made: Callable[..., Callable[..., Any]]) -> None:
        """Wrap what makes a traceable function of arrays like those that it is given; it is asked once a kind."""
        self._made = made
        self._compiled: dict[Hashable, Any] = {}
        self._locks: dict[Hashable, Lock] = {}

    def __call__(self, *args: Any) -> Any:
        """Compile if need be, and run."""
        return self.compile(*args)(*args)

    def compile(self, *args: Any) -> Callable[..., Any]:
        """Compile for arrays like these; a call with such arrays finds it done."""
        kind = kind_of(args)
        if kind not in self._compiled:
            with self._locks.setdefault(kind, Lock()):
                if kind not in self._compiled:
                    jitted: Any = jax.jit(self._made(*args))
                    # Itself: `jax.jit` would compile once more for what another program has left on the devices.
                    self._compiled[kind] = jitted.lower(*args).compile()
        compiled: Callable[..., Any] = self._compiled[kind]
        return compiled

    @property
    def programs(self) -> int:
        """How many programs it has compiled."""
        return len(self._compiled)


def kind_of(arguments: Any) -> Hashable:
    """What tells arguments apart for which different programs are compiled: structure, shapes and types.

    Not where they are: of an array that is on the devices `jax.typeof` tells that, too.
    """
    leaves, tree = jax.tree.flatten(arguments)
    types = map(jax.typeof, leaves)
    return tree, tuple((each.shape, each.dtype, each.weak_type) for each in types)
