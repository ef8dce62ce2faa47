"""Settings of every test; the robot's tests run where neither jax nor hypothesis is installed."""

import gc
import os
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

MAPPINGS = 20_000
"""Pieces of memory above which compiled programs are let go, some twenty each: of 65 530 Linux gives no more, and XLA,
which does not look, crashes or waits forever."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # As of a shell's background jobs: commands that a test starts would inherit it, and not hear its Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)

if find_spec("jax"):
    # The user's cache is not ours to fill, nor is that of an earlier run to be trusted: what one process of this run
    # compiles serves the others, its workers, which inherit the folder.
    if "TEST_PROGRAMS" not in os.environ:
        _programs = TemporaryDirectory(prefix="jaxmpc-programs-")
        os.environ["TEST_PROGRAMS"] = _programs.name
    # Commands that a test starts as processes of their own compile all they run, as on a user's first day.
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    import jax

    jax.config.update("jax_enable_compilation_cache", True)
    jax.config.update("jax_compilation_cache_dir", os.environ["TEST_PROGRAMS"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)

    # Tests compile more than they run: optimised, programs of the arm take a third longer, of its gradients two thirds.
    # Commands in processes of their own are compiled as a user's are.
    jax.config.update("jax_disable_most_optimizations", True)
    if jax.__version_info__ < (0, 11):
        # This XLA takes twice as long without its older code generator.
        os.environ["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false " + os.environ.get("XLA_FLAGS", "")
    jax.config.update("jax_enable_x64", True)
    # As the command line does: one device compiles to other last bits than several.
    jax.config.update("jax_num_cpu_devices", 2)

# CI does so in one of its two runs: it takes an eighth of the time.
if find_spec("jaxtyping") and find_spec("beartype") and "SHAPES_UNCHECKED" not in os.environ:
    from jaxtyping import install_import_hook

    from tests.shapes import with_shapes

    # Before anything of the product is imported. Pytest's option for it would take packages, and all that is in them.
    install_import_hook(with_shapes(), "tests.shapes.checked")

if find_spec("hypothesis"):
    import hypothesis

    # No deadline: a first example compiles. Derandomised: the same tree gives the same verdict.
    hypothesis.settings.register_profile("jaxmpc", deadline=None, derandomize=True, database=None)
    hypothesis.settings.load_profile("jaxmpc")


def pytest_collection_finish() -> None:
    """Look for garbage seldom: tracing makes millions of objects that are none."""
    gc.set_threshold(100_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def traced_anew() -> Iterator[None]:
    """Every process traces what it runs: what the command line keeps might be of functions that a test replaced."""
    if not find_spec("jax"):
        yield
        return
    from jaxmpc.xla import store

    keep_in = store.keep_in
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "keep_in", lambda folder: keep_in(None))
        yield


@pytest.fixture(scope="module", autouse=True)
def room_for_programs() -> Iterator[None]:
    """Let go what earlier files have compiled, before there is too much of it."""
    yield
    mapped = Path("/proc/self/maps")
    if find_spec("jax") and mapped.exists() and mapped.read_bytes().count(b"\n") > MAPPINGS:
        jax.clear_caches()
