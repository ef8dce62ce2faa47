"""Where programs run: on the CPU where that is asked for, and by no other name than ever where they do anyway."""

import threading
from typing import Any

import jax
import pytest

from jaxmpc.xla import place
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


def test_a_device_that_cannot_begin_prints_nothing_beside_who_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()
    told: list[Any] = []

    def refuse() -> None:
        begun.set()
        raise RuntimeError("the GPU takes no further process")

    monkeypatch.setattr(place, "wake", refuse)
    monkeypatch.setattr(threading, "excepthook", told.append)
    before = set(threading.enumerate())
    place.wake_beside()
    for thread in set(threading.enumerate()) - before:
        thread.join()
    assert begun.wait(10.0)
    assert told == []
