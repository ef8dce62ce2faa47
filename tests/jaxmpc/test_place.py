"""Where programs run: on the CPU where that is asked for, and by no other name than ever where they do anyway."""

from typing import Any

import jax
import pytest

from jaxmpc.xla.place import on_cpu, platform


@on_cpu()
def asked() -> str:
    return platform()


def test_beside_a_gpu_the_cpu_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert (platform(), asked(), platform(), asked()) == ("gpu", "cpu", "gpu", "cpu")


def test_without_one_nothing_is_named_so_that_nothing_is_traced_again() -> None:
    traced: list[Any] = []

    @jax.jit
    def program(x: Any) -> Any:
        traced.append(x)
        return x + 1.0

    program(1.0)
    with on_cpu():
        program(1.0)
    assert len(traced) == 1
