"""What an entry point asks of the libraries that it starts, where the user has not."""

import os
from collections.abc import Callable

import pytest

from jaxmpc.terminal.process import memory_as_needed, one_thread_for_blas


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
