"""Traced programs on disk: what one process has traced, the next does not trace again.

JAX's compile cache saves what XLA does; the tracing before it is Python, and of a second run the largest part. What
is kept is the program as `jax.export` writes it, under a name that everything it depends on goes into.
"""

import hashlib
import inspect
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from threading import RLock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import export, monitoring

from jaxmpc.files.sealed import SealError, digest, seal, unseal, write_atomic
from jaxmpc.xla.place import platform

TRACED_BY = ("jax", "jaxlib", "numpy", "equinox", "mujoco", "mujoco-mjx")
"""Packages whose code a traced program is made of."""
TRITON = [export.DisabledSafetyCheck.custom_call("__gpu$xla.gpu.triton")]
"""Kernels that another version may read otherwise: none will, versions are part of a program's name."""

TRACED, SAVED = "/jaxmpc/store/traced_sec", "/jaxmpc/store/tracing_saved_sec"
"""Events for `jax.monitoring`: how long tracing took, or had taken where the program is there [s]."""

PATIENCE = 20.0
"""Longest wait of a thread for another's tracing [s]: beyond it, one of them may wait for what the other holds."""

_folder: Path | None = None
_tracers: Callable[[str, Callable[..., Any], dict[str, Any], dict[str, Any]], bool] | None = None
_turn = RLock()


class Kept(NamedTuple):
    """A traced program."""

    call: Callable[..., list[Any]]
    """From the leaves of the arguments to those of the result; traceable."""
    result: Any
    """Structure of the result, as plain data (`assembled`)."""

    def __call__(self, **arguments: Any) -> Any:
        """What the function returns for arrays of the shapes it was traced for, by name; traceable."""
        return assembled(self.result, iter(self.call(*jax.tree.leaves(arguments))))


def keep_in(folder: Path | None) -> None:
    """Keep traced programs in a folder, or nowhere: for entry points alone, a library keeps none unless told."""
    global _folder
    _folder = folder
    if folder is not None:
        # Now: a source that changes while the process runs is not the one that it has imported.
        source_of("jaxmpc")


def kept_in() -> Path | None:
    """Where programs are kept; None is nowhere."""
    return _folder


def trace_with(tracers: Callable[[str, Callable[..., Any], dict[str, Any], dict[str, Any]], bool] | None) -> None:
    """Have others trace (`jaxmpc.tracers`), or nobody: for entry points alone."""
    global _tracers
    _tracers = tracers


def name_of(function: Callable[..., Any], arguments: dict[str, Any], static: dict[str, Any]) -> str | None:
    """Name of a program's file: a digest of all that it depends on; None where none is kept.

    Args:
        function: Traceable, of a module: what a nested function has closed over cannot be told.
        arguments: The arrays, by name.
        static: What the program is traced for, by name; told apart by `repr`.
    """
    if _folder is None or "<locals>" in function.__qualname__:
        return None
    leaves, tree = jax.tree.flatten(arguments)
    parts = [
        f"{function.__module__}.{function.__qualname__}",
        *map(source_of, sorted({"jaxmpc", function.__module__.partition(".")[0]})),
        *_surroundings(),
        str(jnp.result_type(float)),
        repr(sorted(static.items())),
        repr(tree),
        *(repr(jax.typeof(leaf)) for leaf in leaves),
    ]
    return digest(parts)


def kept_or_plain(function: Callable[..., Any], static: Mapping[str, Any], *arguments: Any) -> Callable[..., Any]:
    """The traced program of a function for arrays like these, where programs are kept, else the function itself.

    Args:
        function: As for `name_of`.
        static: What it is traced for, by name.
        *arguments: Its first ones.

    Returns:
        A function of these; traceable.
    """
    names = [*inspect.signature(function).parameters][: len(arguments)]
    named = dict(zip(names, arguments, strict=True))
    name = name_of(function, named, dict(static))
    kept = None if name is None else program(name, function, named, dict(static))
    if kept is None:
        return partial(function, **static)
    return lambda *given: kept(**dict(zip(names, given, strict=True)))


def program(name: str, function: Callable[..., Any], arguments: dict[str, Any], static: dict[str, Any]) -> Kept | None:
    """The traced program, from its file if there is one, else traced and kept; None where JAX cannot export it.

    Args:
        name: Of its file (`name_of`).
        function: Called as function(**arguments, **static).
        arguments: The arrays, by name.
        static: The rest, by name.
    """
    assert _folder is not None
    path = _folder / f"{name}.npz"
    leaves, tree = jax.tree.flatten(arguments)
    found, event = _kept_in(path), SAVED
    if found is None and _tracers is not None:
        traced = _tracers(name, function, arguments, static)
        found, event = _kept_in(path), TRACED
        if traced and found is None:
            trace_with(None)  # no file can be written, and each program would be traced twice
    if found is None:
        try:
            with _in_turn():
                began = time.perf_counter()
                header, arrays = _traced(function, leaves, tree, static)
                header["traced_s"] = time.perf_counter() - began
        # Of any type: what cannot be exported is then traced in the ordinary way, which says what is wrong if need be.
        except Exception:
            return None
        found, event = (header, arrays), TRACED
        # A full disk costs the next run its tracing, nothing more.
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, seal(header, arrays))
    header, arrays = found
    monitoring.record_event_duration_secs(event, header.get("traced_s", 0.0))
    shapes = header["leaves"]
    # JAX's own file format asks for one more package; all of an exported program but the module follows from its types.
    # Should a JAX no longer take a module so, test_second_process_traces_nothing_and_finds_the_same_bits fails.
    zeros = jax.jit(lambda *_: [jnp.zeros(*leaf) for leaf in shapes], keep_unused=True)
    like = export.export(zeros, platforms=_platforms())(*leaves)
    return Kept(replace(like, mlir_module_serialized=arrays["module"].tobytes()).call, header["result"])


def _kept_in(path: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Header and arrays of a program's file; None where it is missing or damaged."""
    try:
        return unseal(path.read_bytes())
    except (OSError, SealError):
        return None


def assembled(result: Any, leaves: Iterator[Any]) -> Any:
    """What a function returned, of its leaves and `Kept.result`."""
    if result is None:
        return None
    if result == "array":
        return next(leaves)
    module, name = result["kind"]
    kind = getattr(sys.modules[module], name)
    parts = [assembled(part, leaves) for part in result["parts"]]
    return kind(parts) if kind is tuple else kind(*parts)


def _traced(
    function: Callable[..., Any], leaves: list[Any], tree: Any, static: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a program's file."""
    results = []

    def flat(*inner: Any) -> list[Any]:
        result = function(**jax.tree.unflatten(tree, inner), **static)
        results.append(_described(result))
        return jax.tree.leaves(result)

    # An argument that is not used would be left out, and be missing from the types.
    whole = jax.jit(flat, keep_unused=True)
    exported = export.export(whole, platforms=_platforms(), disabled_checks=TRITON)(*leaves)
    found = [[list(aval.shape), aval.dtype.name] for aval in exported.out_avals]
    module = np.frombuffer(exported.mlir_module_serialized, np.uint8)
    return {"result": results[-1], "leaves": found}, {"module": module}


@contextmanager
def _in_turn() -> Iterator[None]:
    """Within it, no other thread traces: tracing is Python's, and of two that take turns at it both are done late."""
    mine = _turn.acquire(timeout=PATIENCE)
    try:
        yield
    finally:
        if mine:
            _turn.release()


def _described(tree: Any) -> Any:
    """A result of arrays, None and tuples, named or not, as plain data; the opposite of `assembled`."""
    if tree is None:
        return None
    if not isinstance(tree, tuple):
        if not jax.tree_util.all_leaves([tree]):
            raise TypeError(f"a {type(tree).__name__} is no tuple")
        return "array"
    kind = type(tree)
    if getattr(sys.modules[kind.__module__], kind.__qualname__, None) is not kind:
        raise TypeError(f"{kind.__qualname__} is not found by its name")
    return {"kind": [kind.__module__, kind.__qualname__], "parts": [_described(part) for part in tree]}


def _platforms() -> list[str] | None:
    """For which to export; None is that of JAX's first device."""
    return ["cpu"] if platform() == "cpu" else None


def _surroundings() -> list[str]:
    """Versions, devices, and on which of them what is traced now would run."""
    return [*_machine(), platform()]


@lru_cache
def _machine() -> list[str]:
    devices = jax.local_devices()
    return [*map(version, TRACED_BY), sys.version, f"{devices[0].device_kind} {len(devices)}"]


@lru_cache
def source_of(package: str) -> str:
    """Digest of every file of a package, or of a module that is a file, as it was when this was first asked."""
    path = Path(str(sys.modules[package].__file__))
    files = [file for file in path.parent.rglob("*") if file.suffix != ".pyc"] if path.stem == "__init__" else [path]
    found = {file.relative_to(path.parent).as_posix(): file for file in files if file.is_file()}
    return digest({name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in found.items()})
