"""What an entry point asks of the libraries that it starts, where the user has not."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import jaxmpc
from jaxmpc import InputError
from jaxmpc.terminal import process
from jaxmpc.terminal.process import REPEATABLE, memory_as_needed, one_thread_for_blas, repeat_to_the_bit


@pytest.mark.parametrize(
    ("ask", "name", "wanted"),
    [
        (one_thread_for_blas, "OPENBLAS_NUM_THREADS", "1"),
        (memory_as_needed, "XLA_PYTHON_CLIENT_PREALLOCATE", "false"),
    ],
)
def test_what_the_user_has_said_stays(
    monkeypatch: pytest.MonkeyPatch, ask: Callable[[], None], name: str, wanted: str
) -> None:
    for said, given in ((None, wanted), ("3", "3")):
        monkeypatch.setenv(name, said or "")
        if said is None:
            monkeypatch.delenv(name)
        ask()
        assert os.environ[name] == given


OTHERS = "--xla_gpu_deterministic_ops=true --xla_gpu_enable_triton_gemm=false"


@pytest.mark.parametrize(
    ("said", "with_plugin", "without"),
    [
        ("", f"--xla_gpu_autotune_level=0 {OTHERS}", ""),
        ("--xla_dump_to=/tmp/x", f"--xla_dump_to=/tmp/x --xla_gpu_autotune_level=0 {OTHERS}", "--xla_dump_to=/tmp/x"),
        ("--xla_gpu_autotune_level=4", f"--xla_gpu_autotune_level=4 {OTHERS}", "--xla_gpu_autotune_level=4"),
    ],
)
def test_a_gpu_repeats_where_there_may_be_one(
    monkeypatch: pytest.MonkeyPatch, said: str, with_plugin: str, without: str
) -> None:
    for plugin, wanted in ((object(), with_plugin), (None, without)):
        monkeypatch.setenv("XLA_FLAGS", said)
        monkeypatch.setattr(process, "find_spec", lambda name, plugin=plugin: plugin)
        repeat_to_the_bit()
        assert os.environ["XLA_FLAGS"] == wanted


def test_xla_knows_the_flags() -> None:
    flags = " ".join(f"--{flag}={value}" for flag, value in REPEATABLE.items())
    code = "import jax; print(jax.numpy.ones(3).sum())"  # XLA aborts the process at a flag it does not know
    surroundings = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", code], env=surroundings, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "3.0\n"), done.stderr


@pytest.mark.parametrize("folder", [3, True, b"programs"])
def test_what_is_no_folder_for_programs_is_refused(
    folder: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It became one of that name where the user was, for all that was compiled from then on."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jax.config.update", lambda key, value: None)
    with pytest.raises(InputError, match=r"^folder = .*must be of the type str"):
        jaxmpc.remember_programs(folder)
    assert list(tmp_path.iterdir()) == []
