"""What an entry point asks of the libraries that it starts, where the user has not."""

import os
from collections.abc import Callable

import pytest

from jaxmpc.terminal import process
from jaxmpc.terminal.process import choose_untimed, memory_as_needed, one_thread_for_blas


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


@pytest.mark.parametrize(
    ("said", "with_plugin", "without"),
    [
        ("", "--xla_gpu_autotune_level=0", ""),
        ("--xla_dump_to=/tmp/x", "--xla_dump_to=/tmp/x --xla_gpu_autotune_level=0", "--xla_dump_to=/tmp/x"),
        ("--xla_gpu_autotune_level=4", "--xla_gpu_autotune_level=4", "--xla_gpu_autotune_level=4"),
    ],
)
def test_algorithms_are_chosen_by_rule_where_there_may_be_a_gpu(
    monkeypatch: pytest.MonkeyPatch, said: str, with_plugin: str, without: str
) -> None:
    for plugin, wanted in ((object(), with_plugin), (None, without)):
        monkeypatch.setenv("XLA_FLAGS", said)
        monkeypatch.setattr(process, "find_spec", lambda name, plugin=plugin: plugin)
        choose_untimed()
        assert os.environ["XLA_FLAGS"] == wanted
