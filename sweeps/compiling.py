"""How long this process has traced and compiled, and how long it would have, had no program been remembered on disk."""

from functools import cache
from typing import NamedTuple

from jaxmpc.xla import store

SPENT, SAVED = "/jax/core/compile/backend_compile_duration", "/jax/compilation_cache/compile_time_saved_sec"
"""Events of JAX; the first includes loading what is remembered."""


class Compiling(NamedTuple):
    """Time of tracing and compiling."""

    spent: float = 0.0
    """That it took [s]."""
    anew: float = 0.0
    """That it takes where nothing is remembered [s]."""

    def since(self, before: "Compiling") -> "Compiling":
        """What came to it."""
        return Compiling(self.spent - before.spent, self.anew - before.anew)


def so_far() -> Compiling:
    """Since the first call in this process."""
    heard = _heard()
    spent = heard[SPENT] + heard[store.TRACED]
    return Compiling(spent, spent + heard[SAVED] + heard[store.SAVED])


@cache
def _heard() -> dict[str, float]:
    from jax import monitoring

    total = dict.fromkeys((SPENT, SAVED, store.TRACED, store.SAVED), 0.0)

    def hear(event: str, duration_secs: float, **_: object) -> None:
        if event in total:
            total[event] += duration_secs

    monitoring.register_event_duration_secs_listener(hear)
    return total
