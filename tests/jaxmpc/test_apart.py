"""A process of its own gives back what comes of it, tells what fails in it, and hears no Ctrl-C."""

import _thread
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.beside import Apart
from jaxmpc.files.errors import InputError
from tests.sources import ROOT

STRUCK = """
import signal, time
import jaxmpc.__main__ as program
from jaxmpc.beside import Apart

# As on a terminal: what a shell has put into the background ignores it, and so does all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

def main():
    try:
        with Apart(time.sleep, 60.0) as other:
            print(other._process.pid, flush=True)
            other.result()
    except KeyboardInterrupt:
        return 130

program.main = main
program.program()
"""

LEFT = """
import time
from jaxmpc.beside import Apart

def busy():
    print("begun", flush=True)
    time.sleep(30.0)

if __name__ == "__main__":
    with Apart(busy) as other:
        other.result()
"""


def wrong(path: Path) -> None:
    raise InputError("seed", -1, bound="positive", remedy="Take another.", file=path)


def test_it_returns_what_the_function_returns() -> None:
    with Apart(np.linspace, 0.0, 1.0, 100_000) as apart:
        np.testing.assert_array_equal(apart.result(), np.linspace(0.0, 1.0, 100_000))


def test_wrong_input_is_told_as_it_would_be_here(tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        wrong(tmp_path)
    with Apart(wrong, tmp_path) as apart, pytest.raises(InputError) as found:
        apart.result()
    assert str(found.value) == str(told.value)


def test_one_that_is_killed_is_told() -> None:
    with Apart(os._exit, 7) as apart, pytest.raises(ChildProcessError, match="code 7"):
        apart.result()


def test_its_end_does_not_wait_for_the_function() -> None:
    began = time.monotonic()
    with Apart(time.sleep, 60.0):
        pass
    assert time.monotonic() - began < 30.0


def test_it_ends_with_a_process_that_is_killed(tmp_path: Path) -> None:
    """At once and without a word, whatever it is at."""
    (tmp_path / "left.py").write_text(LEFT)
    command, environment = [sys.executable, "left.py"], os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout
        assert parent.stdout.readline() == "begun\n"
        parent.kill()
        began = time.monotonic()
        assert parent.communicate() == ("", "")  # of both, who also holds these pipes
    assert time.monotonic() - began < 10.0


def test_ctrl_c_just_before_a_wait_ends_it() -> None:
    # Its flag is set and no system call is broken off, as where it strikes between Python's last look and the call.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    began = time.monotonic()
    try:
        with Apart(time.sleep, 60.0) as apart:
            threading.Timer(0.5, _thread.interrupt_main).start()
            with pytest.raises(KeyboardInterrupt):
                apart.result()
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize("after", [0.0, 1.5], ids=["while it begins", "while it works"])
def test_ctrl_c_on_a_terminal_ends_both_without_a_word(after: float) -> None:
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", STRUCK], env=variables, start_new_session=True, **pipes) as process:
        assert process.stdout is not None
        other = int(process.stdout.readline())
        time.sleep(after)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30.0)
    assert (process.returncode, said) == (130, "")
    with pytest.raises(ProcessLookupError):
        os.kill(other, 0)
