"""Where programs run: on the CPU where that is asked for, and by no other name than ever where they do anyway."""

import threading
from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc.xla import place
from jaxmpc.xla.place import on_cpu, placed, platform


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


@pytest.mark.parametrize("size", [1, 64, 100_000])
def test_what_is_placed_is_a_copy_and_compiles_nothing(size: int) -> None:
    compiled: list[str] = []

    def heard(event: str, seconds: float, **_: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    mine = [np.zeros(size + i) for i in range(5)]  # of some the memory could be shared
    jax.monitoring.register_event_duration_secs_listener(heard)
    try:
        there = placed(mine)
    finally:
        jax.monitoring.unregister_event_duration_listener(heard)
    for each in mine:
        each += 1.0
    assert compiled == []
    assert not any(np.any(each) for each in there)


def test_inside_a_program_it_is_a_number_of_that_program() -> None:
    doubled = jax.jit(lambda x: 2.0 * x + placed(np.ones(3)))
    np.testing.assert_array_equal(doubled(np.arange(3.0)), [1.0, 3.0, 5.0])
