"""Traced programs on disk: the same bits without tracing again, and never those of something else."""

import importlib
import sys
from collections.abc import Iterator
from concurrent.futures import wait
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, Params, closed_loops, evaluation
from jaxmpc.beside import Beside
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.xla import store
from jaxmpc.xla.blocks import OverBlocks, OverDevices
from jaxmpc.xla.once import JitOnce

TRACED: list[str] = []
"""One entry for every time `wave` was traced."""


class Wave(NamedTuple):
    rising: Any
    parts: tuple[Any, Any]
    phase: Any


def wave(t: Any, scale: Any, kind: str) -> Wave:
    TRACED.append(kind)
    function = {"sin": jnp.sin, "cos": jnp.cos}[kind]
    found = scale["one"] * function(t)
    return Wave(found > 0.0, (found, jnp.sum(found)), None)


def wave_alone(t: Any, scale: Any, kind: str, times: float = 1.0) -> Wave:
    """Every row by itself; what has a default need not be given."""
    found = wave(times * t, scale, kind)
    return found._replace(parts=(found.parts[0], t))


def waves(t: Any) -> dict[str, Any]:
    return {"found": jnp.sin(t)}


ARGUMENTS: tuple[Any, Any] = (np.linspace(0.0, 3.0, 50), {"one": 0.3, "not used": np.ones(2)})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where programs are kept meanwhile; the folder itself is made when it is needed."""
    monkeypatch.setattr(store, "_folder", tmp_path / "traced")
    TRACED.clear()
    with jax.enable_x64(True):
        yield tmp_path / "traced"


def another_process(kind: str = "sin") -> Wave:
    """What a process finds that has traced nothing yet."""
    found: Wave = JitOnce(wave, static_argnames=("kind",))(*ARGUMENTS, kind=kind)
    return found


def assert_same(one: Any, other: Any) -> None:
    # Of two structures, too: they must be one.
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_second_process_traces_nothing_and_finds_the_same_bits(folder: Path) -> None:
    plain = jax.jit(wave, static_argnames=("kind",))(*ARGUMENTS, kind="sin")
    TRACED.clear()
    first, second = another_process(), another_process()
    assert TRACED == ["sin"]
    assert_same(first, plain)
    assert_same(second, first)
    assert isinstance(second, Wave)
    assert second.phase is None
    assert len(list(folder.iterdir())) == 1


def test_one_object_serves_several_programs(folder: Path) -> None:
    both = JitOnce(wave, static_argnames=("kind",))
    for _ in range(2):
        np.testing.assert_array_equal(both(*ARGUMENTS, "sin").parts[0], 0.3 * np.sin(ARGUMENTS[0]))
        np.testing.assert_allclose(both(*ARGUMENTS, kind="cos").parts[0], 0.3 * np.cos(ARGUMENTS[0]), rtol=1e-15)
    assert TRACED == ["sin", "cos"]
    assert len(list(folder.iterdir())) == 2


@pytest.fixture
def compilations() -> Iterator[list[str]]:
    """One entry for every program that XLA has compiled."""
    found: list[str] = []

    def heard(event: str, seconds: float, **_: Any) -> None:
        if "backend_compile" in event:
            found.append(event)

    jax.monitoring.register_event_duration_secs_listener(heard)
    yield found
    jax.monitoring.unregister_event_duration_listener(heard)


def test_what_was_compiled_ahead_is_not_traced_or_compiled_again(folder: Path, compilations: list[str]) -> None:
    ahead = JitOnce(wave, static_argnames=("kind",))
    ahead.compile(*ARGUMENTS, kind="sin")
    assert compilations
    compilations.clear()
    found = ahead(*ARGUMENTS, kind="sin")
    assert (TRACED, compilations) == (["sin"], [])
    np.testing.assert_allclose(found.parts[0], 0.3 * np.sin(ARGUMENTS[0]), rtol=1e-15)


def test_so_is_what_no_file_keeps(folder: Path, compilations: list[str]) -> None:
    """A nested function's program has no name to be kept under."""

    def own(t: Any) -> Any:
        TRACED.append("own")
        return jnp.sin(t)

    ahead = JitOnce(own)
    ahead.compile(ARGUMENTS[0])
    assert compilations
    compilations.clear()
    found = ahead(ARGUMENTS[0])
    assert (TRACED, compilations, [*folder.parent.rglob("*.npz")]) == (["own"], [], [])
    np.testing.assert_allclose(found, np.sin(ARGUMENTS[0]), rtol=1e-15)


def test_blocks_of_another_process_are_not_traced_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the number of rows: what is kept is one block, and what all share keeps its structure, None too."""
    rows = np.linspace(0.0, 3.0, 100)

    def blocks(rows: Any, scale: Any = ARGUMENTS[1]) -> Wave:
        found: Wave = OverBlocks(wave_alone, 8, {"kind": "sin"})(rows, scale)
        return found

    with monkeypatch.context() as patch:
        patch.setattr(store, "_folder", None)
        plain = blocks(rows)
    TRACED.clear()
    first, second, fewer = blocks(rows), blocks(rows), blocks(rows[:20])
    assert TRACED == ["sin"]
    assert_same(first, plain)
    assert_same(second, plain)
    np.testing.assert_array_equal(fewer.parts[0], plain.parts[0][:20])
    other = blocks(rows, {"one": 0.3, "none": None})
    assert TRACED == ["sin", "sin"]
    np.testing.assert_array_equal(other.parts[0], plain.parts[0])


def test_shares_of_devices_of_another_process_are_not_traced_again(folder: Path) -> None:
    """One program for each number of rows."""

    def shares(rows: Any) -> Wave:
        found: Wave = OverDevices(wave_alone, {"kind": "sin"})(rows, ARGUMENTS[1])
        return found

    rows = np.linspace(0.0, 3.0, 7)
    first, second = shares(rows), shares(rows)
    assert TRACED == ["sin"]
    assert_same(first, second)
    np.testing.assert_array_equal(first.parts[0], np.sin(rows) * 0.3)
    shares(rows[:2])
    assert TRACED == ["sin", "sin"]


@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: data[:200] + b"?" + data[201:], lambda _: b""])
def test_damaged_file_is_traced_anew_and_mended(folder: Path, damage: Any) -> None:
    first = another_process()
    (path,) = folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    assert_same(another_process(), first)
    assert TRACED == ["sin", "sin"]
    assert_same(another_process(), first)
    assert TRACED == ["sin", "sin"]


def test_name_tells_all_that_a_program_depends_on(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    t, scale = ARGUMENTS

    def name(t: Any = t, scale: Any = scale, kind: str = "sin") -> str | None:
        return store.name_of(wave, {"t": t, "scale": scale}, {"kind": kind})

    names = [name(), name(t[:-1]), name(t.astype(np.float32)), name(scale={"two": 0.3}), name(kind="cos")]
    names += [name(scale=scale | {"one": np.asarray(0.3)}), store.name_of(waves, {"t": t, "scale": scale}, {})]
    with jax.enable_x64(False):
        names.append(name())
    monkeypatch.setattr(store, "_surroundings", lambda: ["another JAX"])
    names.append(name())
    assert None not in names
    assert len(set(names)) == len(names)


def test_source_that_changed_misses(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module of a package on which the traced one may call: any file of the package counts."""
    package = tmp_path / "kept_somewhere"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "law.py").write_text("def law(t):\n    return (2.0 * t,)\n")
    (package / "arm.xml").write_text("<arm/>")
    monkeypatch.syspath_prepend(str(tmp_path))
    law = importlib.import_module("kept_somewhere.law").law

    def name() -> str | None:
        store.source_of.cache_clear()
        return store.name_of(law, {"t": 1.0}, {})

    try:
        names = [name(), name()]
        (package / "arm.xml").write_text("<arm />")
        names.append(name())
    finally:
        store.source_of.cache_clear()
        del sys.modules["kept_somewhere"], sys.modules["kept_somewhere.law"]
    assert names[0] == names[1] != names[2]


def test_nothing_is_kept_unless_an_entry_point_says_so(folder: Path) -> None:
    store.keep_in(None)
    another_process()
    assert not folder.exists()


def test_what_cannot_be_kept_is_compiled_as_ever(folder: Path) -> None:
    """A result that is no tuple, a function that has closed over something, a disk that takes nothing."""
    t, factor = ARGUMENTS[0], 3.0

    def closed(t: Any) -> tuple[Any]:
        return (factor * t,)

    np.testing.assert_array_equal(JitOnce(waves)(t)["found"], np.sin(t))
    np.testing.assert_array_equal(JitOnce(closed)(t)[0], 3.0 * t)
    assert not folder.exists()
    folder.write_text("a file where the folder should be")
    assert_same(another_process(), another_process())


def test_derivatives_pass_by_the_store(folder: Path) -> None:
    jitted = JitOnce(wave, static_argnames=("kind",))
    slope = jax.grad(lambda t: jitted(t, ARGUMENTS[1], kind="sin").parts[1])(ARGUMENTS[0])
    np.testing.assert_allclose(slope, 0.3 * np.cos(ARGUMENTS[0]), rtol=1e-14)
    assert not folder.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["table-1", "table-1-wam"])
def test_all_of_an_evaluation_can_be_kept(folder: Path, name: str) -> None:
    """Traced alone: what compiling makes of it, the tests of the command line see."""
    experiment = msgspec.structs.replace(Experiment.published(name), duration=4.0, settle=3.0)
    scene, world = scenario_data(experiment), program_spec(experiment)
    params = jax.tree.map(lambda leaf: np.asarray(leaf)[None], Params())

    def kept(function: Any, static: dict[str, Any], **arguments: Any) -> Any:
        """The program's result, in shape alone."""
        name = store.name_of(function, arguments, static)
        assert name is not None
        found = store.program(name, function, arguments, static)
        assert found is not None
        leaves = jax.eval_shape(found.call, *jax.tree.leaves(arguments))
        return store.assembled(found.result, iter(np.zeros(leaf.shape, leaf.dtype) for leaf in leaves))

    loops = kept(closed_loops.close_loops, {}, params=params, stiffness=scene.stiffness, path=scene.path)
    static = {"world": world, "dtype": "float64", "traced": True}
    run = kept(closed_loops.run_loops, static, loops=loops, scene=scene)
    margins = kept(closed_loops.margins_of, {"ideal": scene.path.ideal}, loops=loops)
    outcome = kept(evaluation.shaped_outcome, {"batch": ()}, margins=margins, run=run)
    assert outcome.metrics.rms.shape == (3, 3)
    assert outcome.trace.force.shape == (3, 3, experiment.steps)
    assert len(list(folder.iterdir())) == 4


def test_threads_trace_one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """And do not wait for ever for one that may wait for them."""
    entered, leave = Event(), Event()

    def first() -> None:
        with store._in_turn(), store._in_turn():  # what traces may trace more
            entered.set()
            leave.wait(10.0)

    def second() -> bool:
        with store._in_turn():
            return leave.is_set()

    with Beside(2) as threads:
        tracing = threads.submit(first)
        assert entered.wait(10.0)
        waiting = threads.submit(second)
        assert not wait([waiting], timeout=0.05).done
        leave.set()
        assert waiting.result(10.0)
        tracing.result(10.0)
        monkeypatch.setattr(store, "PATIENCE", 0.01)
        entered.clear()
        leave.clear()
        tracing = threads.submit(first)
        assert entered.wait(10.0)
        assert not threads.submit(second).result(10.0)
        leave.set()
        tracing.result(10.0)
    with store._in_turn():
        assert store._turn.acquire(blocking=False)  # nobody has kept it
        store._turn.release()
