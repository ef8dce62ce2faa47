"""A program that several threads call is traced and compiled by one of them."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.xla.shared import JitShared


def counted() -> tuple[JitShared, list[Any]]:
    """A program, and an entry for each time that it was traced."""
    traced: list[Any] = []

    def function(x: Any, more: Any) -> Any:
        traced.append(jax.typeof(x))
        return jnp.sin(x) + more["y"]

    return JitShared(lambda *_: function), traced


def test_threads_that_come_together_compile_once() -> None:
    program, traced = counted()
    begin, x = Barrier(8), np.arange(3.0)

    def call(i: int) -> np.ndarray:
        begin.wait()
        return np.asarray(program(x, {"y": np.float32(i)}))

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(call, range(8)))
    np.testing.assert_allclose(found, np.sin(x) + np.arange(8)[:, None], rtol=1e-6)
    assert len(traced) == program.programs == 1


def test_what_was_compiled_ahead_runs() -> None:
    program, traced = counted()
    program.compile(np.zeros(3), {"y": 1.0})
    assert len(traced) == 1
    np.testing.assert_allclose(program(np.ones(3), {"y": 2.0}), np.sin(np.ones(3)) + 2.0, rtol=1e-6)
    assert len(traced) == program.programs == 1
    program(np.ones(4), {"y": 2.0})
    assert len(traced) == program.programs == 2
