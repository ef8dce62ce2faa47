"""Ctrl-C and a full disk at every verb that writes: what was there before is there after, and one line says so.

Both strike in the middle of a write, the first or the second; Ctrl-C also at random moments of processes of their own,
and a full disk, which is a limit of what a file may hold, at the real commands.
"""

import errno
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.cli import main
from jaxmpc.files import sealed
from tests.sources import ROOT
from tests.twin.test_replay import flown
from tuning import trials
from tuning.trials import Job, Outcomes, drawn

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
TUNE = """\
[tune]
starts = 2
steps = 2
train_seeds = [0]
heldout_seeds = [1000]
duration = 5.0
settle = 1.2
margin_points = 0
[goals]
ideal = true
M_s = 9.0
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
    "limit": ["limit", "short.toml", "--params", "text", "-o", "made.json"],
    "replay": [
        "replay",
        "flown/flight.npz",
        "--artifact",
        "flown/controller.npz",
        "--report",
        "made.html",
        "--picture",
        "made.png",
    ],
    "tune": ["tune", "tune.toml", "-o", "tuned", "--quiet"],
    "trials": ["trials", "text", "--trials", "5", "-o", "tried", "--quiet"],
    "demo": ["demo", "-o", "shown"],
}
"""A command of each verb that writes; those of `run` stand in tests/twin/test_recording_kept.py. `twin`, `check`,
`doctor`, `list` and `completion` write nothing."""
QUICK = ("identify", "sweep best", "sign", "replay", "trials", "demo")
SEVERAL = ("identify", "sweep best", "replay", "trials", "sweep report", "tune")
"""Those of more than one file."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands need."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "short.toml").write_text(EXPERIMENT)
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "tune.toml").write_text(TUNE)
    before = Path.cwd()
    os.chdir(folder)
    try:
        assert main(["sweep", "sweep.toml", "-o", "done", "--quiet"]) == 0
        assert main([*CASES["freeze"][:-1], "controller.npz"]) == 0
    finally:
        os.chdir(before)
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "key"], cwd=folder, check=True)
    (folder / "flown").mkdir()
    flown(folder / "flown")
    return folder


def there(folder: Path) -> dict[str, bytes]:
    """Files with their content, dotted ones too, as those that are half written are called."""
    return {f"{path.relative_to(folder)}": path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def marked(names: Iterable[str]) -> list[Any]:
    return [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in names]


@pytest.fixture(autouse=True)
def _cores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def outcomes_of(job: Job, firsts: Sequence[int]) -> Iterator[Outcomes]:
    for _ in firsts:
        flat = np.zeros((drawn.BLOCK, len(job.controllers)))
        small, when = np.full((*flat.shape, 3), 0.1), (flat + np.nan, flat + 0.9, flat + np.inf)
        yield Outcomes(flat.astype(np.int8), *when, small, small, small, 0.1 * small, flat == 1.0)


@pytest.fixture(autouse=True)
def _nothing_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is written is the matter here: trials that nobody flies, no arm in the demo, no law of JAX in a replay."""
    monkeypatch.setattr(trials, "outcomes_of", outcomes_of)
    monkeypatch.setattr("tuning.trials.linear_margins.margins_table", lambda *_: [])
    monkeypatch.setattr("jaxmpc.cli.demo.Apart", lambda *_: nullcontext())
    monkeypatch.setattr("jaxmpc.cli.demo._paper", lambda *_: None)
    monkeypatch.setattr("jaxmpc.export.replay.replay_law", lambda *_: {})


@pytest.mark.parametrize("name", marked(CASES))
@pytest.mark.parametrize(("strike", "code"), [(full(), 1), (KeyboardInterrupt(), 130)], ids=["full disk", "Ctrl-C"])
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
    if code == 1:
        assert re.search(r"\w\.(npz|toml|png|html|csv|json|sig)\b", told), "the file that could not be written"
    assert changed(before, there(desk)) == set()


def changed(before: dict[str, bytes], after: dict[str, bytes]) -> set[str]:
    found = {path for path in {*before, *after} if before.get(path) != after.get(path)}
    # A lease is no result: it says that nobody works there any more, once its process has gone.
    return {path for path in found if "/leases/" not in path}


@pytest.mark.parametrize("name", marked(SEVERAL))
def test_what_a_disk_that_fills_leaves_is_what_a_whole_run_makes(
    desk: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    before, fsync, calls = there(desk), os.fsync, iter(range(1000))

    def second(descriptor: int) -> None:
        # The first file and its folder, then no more.
        if next(calls) >= 2:
            raise full()
        fsync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(sealed.os, "fsync", second)
        assert main(CASES[name]) == 1
    left = there(desk)
    assert main(CASES[name]) == 0
    whole = there(desk)
    assert len(changed(before, left)) == 1
    assert changed(before, left) < changed(before, whole)
    assert all(left[path] == whole[path] for path in changed(before, left) if path in left)
    for path in changed(before, whole):
        (desk / path).unlink()


NO_ROOM = ("bash", "-c", 'ulimit -f 0; exec "$@"', "-")
"""Files of nothing at most; Python then hears of EFBIG, as it is deaf to the signal."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "sign" else pytest.mark.slow) for name in CASES]
)
def test_the_real_command_on_a_full_disk(desk: Path, name: str, tmp_path: Path) -> None:
    """The cache of programs is on that disk too, and nobody hears of it."""
    before = there(desk)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("JAX_ENABLE_COMPILATION_CACHE", None)
    command = [*NO_ROOM, sys.executable, "-m", "jaxmpc", *CASES[name]]
    ran = subprocess.run(command, cwd=desk, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 1, ran.stderr
    assert "File too large" in ran.stderr.strip().splitlines()[-1]
    assert "Traceback" not in ran.stderr
    assert "Warning" not in ran.stderr
    assert changed(before, there(desk)) == set()
    # Matplotlib's own, an empty list of fonts, is made anew by whoever cannot read it.
    assert [path for path in (tmp_path / "jaxmpc").rglob("*") if path.is_file()] == []


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


@pytest.mark.parametrize(("strike", "code"), [("KeyboardInterrupt", 130), ("OSError", 1)])
@pytest.mark.parametrize("busy", ["Beside(1)", "Apart(time.sleep, 60.0)"])
def test_a_process_that_fails_ends_while_another_or_a_thread_still_works(busy: str, strike: str, code: int) -> None:
    """And ends the other, or a pipe that both hold would be waited for."""
    script = f"""
import time
import jaxmpc.__main__ as program
from jaxmpc.beside import Apart, Beside

def main():
    try:
        with {busy} as other:
            if isinstance(other, Beside):
                other.submit(time.sleep, 60.0)
            raise {strike}
    except {strike}:
        return {code}

program.main = main
program.program()
"""
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run([sys.executable, "-c", script], env=variables, capture_output=True, check=False, timeout=30.0)
    assert (ran.returncode, ran.stderr) == (code, b"")


def test_ctrl_c_while_a_verb_is_imported_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def struck(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxmpc.cli.import_module", struck)
    assert main(["simulate", "short.toml"]) == 130
    assert capsys.readouterr().err == "jaxmpc simulate: interrupted\n"


def test_ctrl_c_while_an_extension_is_loaded_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of NumPy and JAX then say that they could not be loaded."""

    def struck(name: str) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("Encountered an error while initializing the extension.") from None

    monkeypatch.setattr("jaxmpc.cli.import_module", struck)
    assert main(["simulate", "short.toml"]) == 130
    assert capsys.readouterr().err == "jaxmpc simulate: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_extension_that_cannot_be_loaded_is_no_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise ImportError("Encountered an error while initializing the extension.")

    monkeypatch.setattr("jaxmpc.cli.import_module", broken)
    with pytest.raises(ImportError, match="initializing"):
        main(["simulate", "short.toml"])
