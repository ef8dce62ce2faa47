"""What processes trace for this one is what it would trace itself, and what they cannot trace is traced here."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import tracers
from jaxmpc.xla import store
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import on_cpu
from tests.sources import ROOT

HERE: list[str] = []
"""One entry for every time that this process traced."""
T = np.linspace(0.0, 3.0, 50)

SLOW = """
import os, time
from pathlib import Path

def slow(t):
    Path("begun").write_text(str(os.getpid()))
    time.sleep(600.0)
    return (t,)
"""
"""A module: of `__main__`, which has another name there, nothing is traced apart."""
LEFT = """
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.tracers import Tracers
from jaxmpc.xla import store
from jaxmpc.xla.once import JitOnce
from slow import slow

if __name__ == "__main__":
    use_all_cores()
    store.trace_with(Tracers(1, store.kept_in()))
    JitOnce(slow)(1.0)
"""


def swing(t: Any, shared: Any, kind: str) -> tuple[Any, ...]:
    HERE.append(kind)
    return {"sin": jnp.sin, "cos": jnp.cos}[kind](shared["one"] * t), t * 2


@JitOnce
def decorated(t: Any) -> tuple[Any]:
    HERE.append("decorated")
    return (jnp.tan(t),)


def named(t: Any, kind: Callable[[Any], Any]) -> tuple[Any]:
    HERE.append("named")
    return (kind(t),)


def swung(kind: str = "sin") -> list[np.ndarray]:
    """What a process finds that has not looked for the program yet."""
    found = JitOnce(swing, static_argnames=("kind",))(T, {"one": 0.5, "none": None}, kind=kind)
    return [*map(np.asarray, found)]


@pytest.fixture(scope="module")
def one_tracer(tmp_path_factory: pytest.TempPathFactory) -> tracers.Tracers:
    """A single one, so that who leaves it unable to answer is noticed by the next test."""
    return tracers.Tracers(1, tmp_path_factory.mktemp("apart") / "traced")


@pytest.fixture
def apart(one_tracer: tracers.Tracers, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where they keep programs; this process keeps them there too, and lets them trace."""
    folder = one_tracer.folder
    monkeypatch.setattr(store, "_folder", folder)
    monkeypatch.setattr(store, "_tracers", one_tracer)
    for file in folder.glob("*.npz"):
        file.unlink()
    HERE.clear()
    with jax.enable_x64(True):
        yield folder


@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("place", [nullcontext, on_cpu])
def test_the_program_and_its_bits_are_the_same(
    apart: Path, wide: bool, place: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with jax.enable_x64(wide), place():
        found = swung()
        assert HERE == []
        monkeypatch.setattr(store, "_folder", tmp_path)
        monkeypatch.setattr(store, "_tracers", None)
        alone = swung()
        assert HERE == ["sin"]
    kept, own = (store._kept_in(*folder.iterdir()) for folder in (apart, tmp_path))
    assert kept
    assert own
    assert kept[0] | {"traced_s": 0.0} == own[0] | {"traced_s": 0.0}
    assert found[0].dtype == (np.float64 if wide else np.float32)
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one, other)


def test_so_is_one_that_a_decorator_compiles(apart: Path) -> None:
    np.testing.assert_allclose(decorated(T)[0], np.tan(T), rtol=1e-13)  # a tangent by XLA, near a pole
    assert HERE == []


def test_what_cannot_be_sent_is_traced_here(apart: Path) -> None:
    """A static argument without a name of its own; after it, the next is traced apart again."""
    (found,) = JitOnce(named, static_argnames=("kind",))(T, kind=lambda t: 3.0 * t)
    np.testing.assert_array_equal(found, 3.0 * T)
    assert HERE == ["named"]
    swung()
    assert HERE == ["named"]


def test_what_has_another_name_there_is_traced_here(apart: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its sources have changed since this process read them, or it has other devices."""
    monkeypatch.setattr(store, "_surroundings", lambda: ["another JAX"])
    np.testing.assert_array_equal(swung()[0], swung()[0])
    assert HERE == ["sin"]


def test_where_no_file_can_be_written_they_are_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They would trace what is then traced here once more."""
    asked = []

    def tracing(*order: Any) -> bool:
        asked.append(order)
        return True

    (tmp_path / "file").touch()
    monkeypatch.setattr(store, "_folder", tmp_path / "file")
    monkeypatch.setattr(store, "_tracers", tracing)
    HERE.clear()
    with jax.enable_x64(True):
        swung("sin"), swung("cos")
    assert HERE == ["sin", "cos"]
    assert len(asked) == 1


def test_what_fails_there_fails_here(apart: Path) -> None:
    with pytest.raises(KeyError, match="tan"):
        swung("tan")
    swung("cos")
    assert "cos" not in HERE


def test_one_that_fails_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As where a source has changed since, and has no such function; what it was to trace is traced here."""

    def gone(t: Any) -> tuple[Any]:
        HERE.append("gone")
        return (3.0 * t,)

    gone.__qualname__ = "gone"
    monkeypatch.setattr(sys.modules[__name__], "gone", gone, raising=False)
    before = set(active_children())
    monkeypatch.setattr(store, "_folder", tmp_path)
    monkeypatch.setattr(store, "_tracers", tracers.Tracers(1, tmp_path))
    (tracer,) = set(active_children()) - before
    HERE.clear()
    with jax.enable_x64(True):
        np.testing.assert_array_equal(JitOnce(gone)(T)[0], 3.0 * T)
    assert HERE == ["gone"]
    tracer.join(10.0)
    assert capfd.readouterr().err == ""


def test_killed_ones_are_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = set(active_children())
    monkeypatch.setattr(store, "_folder", tmp_path)
    monkeypatch.setattr(store, "_tracers", tracers.Tracers(1, tmp_path))
    (tracer,) = set(active_children()) - before
    tracer.kill()
    HERE.clear()
    with jax.enable_x64(True):
        swung("sin"), swung("cos")
    assert HERE == ["sin", "cos"]


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_they_end_with_the_one_they_serve(ending: signal.Signals, tmp_path: Path) -> None:
    """In the midst of a program, too."""
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "left.py").write_text(LEFT)
    begun = tmp_path / "begun"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "1"
    with subprocess.Popen([sys.executable, "left.py"], cwd=tmp_path, env=environment) as parent:
        while not (begun.exists() and begun.read_text()) and parent.poll() is None:
            time.sleep(0.1)
        pid = int(begun.read_text())
        apart = pid != parent.pid
        parent.send_signal(ending)
    assert apart
    deadline = time.monotonic() + 20.0
    with suppress(ProcessLookupError):
        while time.monotonic() < deadline:
            os.kill(pid, 0)
            time.sleep(0.1)
        pytest.fail(f"{pid} goes on")


def test_they_import_what_they_will_be_asked_for_before_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "told_of_itself.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    tracer = tracers.Tracers(1, tmp_path / "traced", "told_of_itself")
    deadline = time.monotonic() + 60.0  # a process and JAX, on a busy machine
    while not (tmp_path / "imported").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert (tmp_path / "imported").exists()
    del tracer  # which ends with whoever has it


@pytest.mark.parametrize(
    ("cores", "gpu", "asked"), [(64, True, 4), (16, True, 4), (8, True, 2), (3, True, 0), (64, False, 0)]
)
def test_they_are_asked_for_where_there_are_cores_for_them(
    cores: int, gpu: bool, asked: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    monkeypatch.setattr(tracers, "Tracers", lambda *asked: found.append(asked))
    monkeypatch.setattr(tracers, "may_have_a_gpu", lambda: gpu)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))
    monkeypatch.setattr(store, "_tracers", None)
    monkeypatch.setattr(store, "_folder", tmp_path)
    tracers.trace_apart(__name__)
    assert found == ([(asked, tmp_path, __name__)] if asked else [])
    monkeypatch.setattr(store, "_folder", None)
    tracers.trace_apart(__name__)  # nothing is kept, and nobody could hand it over
    assert len(found) == bool(asked)
