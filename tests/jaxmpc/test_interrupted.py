"""Ctrl-C and a full disk at every verb that writes: what was there before is there after, and one line says so.

Both strike in the middle of the first write; Ctrl-C also at random moments of processes of their own.
"""

import errno
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxmpc.cli import main
from jaxmpc.files import sealed
from tests.sources import ROOT

EXPERIMENT = """\
name = "short"
duration = 0.6
settle = 0.2
stiffness = [810.0]
motion = { kind = "none" }
"""
SWEEP = """\
[experiment]
file = "short.toml"
[sweep]
kind = "grid"
[sweep.axes]
K2 = [10.0, 20.0, 30.0]
"""
CASES = {
    "freeze": ["freeze", "text", "--experiment", "short.toml", "--max-ms", "9", "-o", "made.npz"],
    "identify": ["identify", "twin-motion", "-o", "made.toml", "--figure", "made.png"],
    "simulate": ["simulate", "short.toml", "-o", "simulated"],
    "sweep": ["sweep", "sweep.toml", "-o", "swept", "--quiet"],
    "sweep best": ["sweep", "best", "done", "--max-ms", "9", "--csv", "made.csv", "--params", "made.toml"],
    "sweep report": ["sweep", "report", "done", "-o", "reported", "--csv", "made.csv"],
    "compare": ["compare", "text", "cautious", "--experiment", "short.toml", "--seeds", "0", "-o", "made.html"],
    "sign": ["sign", "controller.npz", "--key", "key"],
}
"""A command of each verb that writes; those of `run` stand in tests/twin/test_recording_kept.py."""
QUICK = ("identify", "sweep best", "sign")


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands need."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "short.toml").write_text(EXPERIMENT)
    (folder / "sweep.toml").write_text(SWEEP)
    before = Path.cwd()
    os.chdir(folder)
    try:
        assert main(["sweep", "sweep.toml", "-o", "done", "--quiet"]) == 0
        assert main([*CASES["freeze"][:-1], "controller.npz"]) == 0
    finally:
        os.chdir(before)
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "key"], cwd=folder, check=True)
    return folder


def there(folder: Path) -> dict[str, bytes]:
    """Files with their content, dotted ones too, as those that are half written are called."""
    return {f"{path.relative_to(folder)}": path.read_bytes() for path in folder.rglob("*") if path.is_file()}


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
SLOW = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in CASES]


@pytest.fixture(autouse=True)
def _cores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize(("strike", "code"), [(FULL, 1), (KeyboardInterrupt(), 130)], ids=["full disk", "Ctrl-C"])
def test_what_was_there_is_there(
    desk: Path,
    name: str,
    strike: BaseException,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(desk)
    before = there(desk)

    def fsync(descriptor: int) -> None:
        raise strike

    monkeypatch.setattr(sealed.os, "fsync", fsync)
    assert main(CASES[name]) == code
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert told.startswith(f"jaxmpc {CASES[name][0]}: ")
    assert ("No space left" if code == 1 else "interrupted") in told
    after = there(desk)
    changed = {path for path in {*before, *after} if before.get(path) != after.get(path)}
    # A lease is no result: it says that nobody works there any more, once its process has gone.
    assert not {path for path in changed if "/leases/" not in path}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["identify", "simulate", "freeze", "sweep best"])
def test_ctrl_c_at_random_moments(desk: Path, name: str, tmp_path: Path) -> None:
    """The real command in a process of its own, eight times: done, or interrupted with nothing half written."""
    choice, codes = random.Random(14), []
    command = [sys.executable, "-m", "jaxmpc", *CASES[name]]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("JAX_ENABLE_COMPILATION_CACHE", None)
    before = there(desk)
    began = time.monotonic()
    subprocess.run(command, cwd=desk, env=environment, check=True, capture_output=True)
    whole, took = there(desk), time.monotonic() - began
    for _ in range(8):
        process = subprocess.Popen(
            command, cwd=desk, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        # Before that the interpreter itself is still starting, and whatever it says is not ours.
        time.sleep(0.3 + choice.uniform(0.0, 0.9 * took))
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=120)
        codes.append(process.returncode)
        assert process.returncode in (0, 130), told
        assert "Traceback" not in told
        after = there(desk)
        for path in {*before, *after}:
            assert after.get(path) in (before.get(path), whole.get(path)), path
    assert 130 in codes


DEAF = """
import gc, signal, sys, time
from jaxmpc.terminal.interruption import always_heard

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job begins without it

def strike(phase, info):
    gc.callbacks.clear()
    signal.raise_signal(signal.SIGINT)

gc.callbacks.append(strike)
try:
    with always_heard():
        gc.collect()
        time.sleep(5.0)
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_ctrl_c_is_heard_where_python_can_raise_nothing() -> None:
    """As JAX's callback of the garbage collector, which is busy for seconds of a tuning job."""
    ran = subprocess.run([sys.executable, "-c", DEAF], env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert ran.returncode == 130


def test_ctrl_c_ends_the_process_while_a_thread_still_works() -> None:
    code = """
import time
import jaxmpc.__main__ as program
from jaxmpc.beside import Beside

def main():
    try:
        with Beside(1) as beside:
            beside.submit(time.sleep, 60.0)
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        return 130

program.main = main
program.program()
"""
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run([sys.executable, "-c", code], env=variables, check=False, timeout=30.0)
    assert ran.returncode == 130


def test_ctrl_c_while_a_verb_is_imported_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def struck(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxmpc.cli.import_module", struck)
    assert main(["simulate", "short.toml"]) == 130
    assert capsys.readouterr().err == "jaxmpc simulate: interrupted\n"
