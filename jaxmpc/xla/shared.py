"""A compiled function that several threads call: the first compiles it, and the others wait instead of doing so too.

For programs that run many times: unlike `jaxmpc.xla.once.JitOnce` it compiles with all optimisations.
"""

from collections.abc import Callable
from threading import Lock
from typing import Any

import jax


class JitShared:
    """`jax.jit` for several threads, which may be compiled before there is anything to run it with."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a traceable function of arrays."""
        self._jitted: Any = jax.jit(function)
        self._compiled: set[Any] = set()
        self._lock = Lock()

    def __call__(self, *args: Any) -> Any:
        """Compile if need be, and run."""
        self.compile(*args)
        return self._jitted(*args)

    def compile(self, *args: Any) -> None:
        """Compile for arrays like these; a call with such arrays finds it done."""
        leaves, tree = jax.tree.flatten(args)
        kind = tree, tuple(map(jax.typeof, leaves))
        if kind in self._compiled:
            return
        with self._lock:
            if kind not in self._compiled:
                self._jitted.lower(*args).compile()
                self._compiled.add(kind)

    @property
    def programs(self) -> int:
        """How many programs it has compiled."""
        return len(self._compiled)
