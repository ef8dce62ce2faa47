"""Quick compilation of programs that run only a few times: in half the time, and they take twice as long or more.

Several threads may call: of those that want the same program one compiles it, and the others wait.
"""

import inspect
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from functools import lru_cache
from threading import Lock
from typing import Any

import jax

from jaxmpc.xla import store
from jaxmpc.xla.place import platform
from jaxmpc.xla.shared import kind_of

OPTIONS: tuple[dict[str, Any], ...] = (
    {"xla_cpu_use_fusion_emitters": False},
    {
        "xla_backend_optimization_level": 0,
        "xla_llvm_enable_alias_scope_metadata": False,
        "xla_llvm_enable_noalias_metadata": False,
        "xla_llvm_enable_invariant_load_metadata": False,
    },
)
"""XLA's older code generator for CPUs (measured on the arm with jaxlib 0.10: 7 s instead of 15 s); where that is gone,
LLVM's optimisations off, and without what only they read (jaxlib 0.12: 6 s instead of 16 s)."""


class JitOnce:
    """`jax.jit` that compiles quickly; inside another program, compiling is that program's affair.

    Where an entry point keeps traced programs (`jaxmpc.xla.store`), those are used.
    """

    def __init__(self, function: Callable[..., Any], static_argnames: Sequence[str] = ()) -> None:
        """Wrap a traceable function; `static_argnames` as in `jax.jit`."""
        self._function, self._static = function, tuple(static_argnames)
        self.__wrapped__ = function
        self._plain = jax.jit(function, static_argnames=self._static)
        self._kept: dict[str, store.Kept | None] = {}
        self._by_platform: dict[str, Any] = {}
        self._locks: dict[Hashable, Lock] = {}

    @property
    def _quick(self) -> Any:
        return self._by_platform.setdefault(
            platform(), jax.jit(self._function, compiler_options=_options(platform()), static_argnames=self._static)
        )

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Compile if need be, and run."""
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            return self._plain(*args, **kwargs)
        with self._one_at_a_time(args, kwargs):
            kept = self._from_store(args, kwargs)
            return self._quick(*args, **kwargs) if kept is None else kept(**self._named(args, kwargs)[0])

    def compile(self, *args: Any, **kwargs: Any) -> None:
        """Compile for arrays like these, on their devices, before they are there to run with."""
        self.traced(*args, **kwargs)()

    def traced(self, *args: Any, **kwargs: Any) -> Callable[[], None]:
        """The same in two steps: trace, which keeps Python busy; what is returned compiles, which does not."""
        alone = self._one_at_a_time(args, kwargs)
        with alone:
            kept = self._from_store(args, kwargs)
            if kept is None:
                lowered = self._quick.lower(*args, **kwargs)
            else:
                program: Any = kept.call
                lowered = program.lower(*jax.tree.leaves(self._named(args, kwargs)[0]))

        def finish() -> None:
            with alone:
                lowered.compile()

        return finish

    def _one_at_a_time(self, args: Any, kwargs: Any) -> Lock:
        """Held while a program is compiled, or begun: JAX does not wait for what it begins."""
        arguments, static = self._named(args, kwargs)
        return self._locks.setdefault((kind_of(arguments), *sorted(static.items()), platform()), Lock())

    def _from_store(self, args: Any, kwargs: Any) -> store.Kept | None:
        arguments, static = self._named(args, kwargs)
        name = store.name_of(self._function, arguments, static)
        if name is None:
            return None
        if name not in self._kept:
            found = store.program(name, self._function, arguments, static)
            quick = found and found._replace(call=jax.jit(found.call, compiler_options=_options(platform())))
            self._kept[name] = quick
        return self._kept[name]

    def _named(self, args: Any, kwargs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arguments by name: arrays, and static ones."""
        arguments = dict(inspect.signature(self._function).bind(*args, **kwargs).arguments)
        return arguments, {name: arguments.pop(name) for name in self._static if name in arguments}

    @property
    def programs(self) -> int:
        """How many programs it has compiled."""
        # No public way tells; every test that counts compilations fails when this one goes.
        quick = sum(int(one._cache_size()) for one in self._by_platform.values())
        return quick + sum(kept is not None for kept in self._kept.values())


@lru_cache
def _options(platform: str) -> dict[str, Any] | None:
    """The first of `OPTIONS` that this version of XLA knows, on a CPU."""
    if platform != "cpu":
        return None
    for options in OPTIONS:
        # jaxlib has no type of its own for an option that it does not know.
        with suppress(Exception):
            jax.jit(lambda x: x, compiler_options=options)(0.0)
            return options
    return None
