"""The flights of the guest: `jaxmpc run` against `jaxmpc twin` on the kernel's CAN, clean and with a fault in contact.

Prints a line `FLIGHT {…}` of JSON for each: what was measured, and what of it is not as it has to be.
"""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from deploy.flight.recorder import read
from tests.kernel.bus_tap import CHANNEL, BusTap, send_bus_off

CONTROLLER, FOLDER = Path("/controller.npz"), Path("/tmp/flights")
WANTED, HELD = -5.0, 1.0
"""Wanted force [N], and how much of the end of the contact it must have been met in [s]."""
PRESSED_FOR = 0.6
"""Time in contact after which a fault sets in [s]; a ramp of 10 N/s is done by then."""
LET_GO = 0.010
"""Within which the arm must be idle after its controller died or stood still [s]: the guide's figure."""
NAMED = 1.0
"""Within which a run must say what stopped it [s]."""
HUNG = 60.0
"""Patience with a twin that does not begin, and a duration that no flight with a fault reaches [s]."""
STORY = ("force sensor tared", "armed:", "approach:", "contact:", "retract", "stopped:", "ended: stopped, finished")
"""Beginnings of lines of a flight without a fault."""
_BUS = ("-i", "socketcan", "-c", CHANNEL)


class Processes(NamedTuple):
    """What a fault may strike."""

    twin: int
    controller: int
    watchdog: int


class Fault(NamedTuple):
    """A fault in contact, and how the run has to end."""

    name: str
    strike: Callable[[Processes], object]
    reason: str
    undo: Callable[[Processes], object] = lambda _: None
    idle: bool = False
    """Whether both orders to idle have to be on the bus within `LET_GO`."""
    killed: bool = False
    """Whether it is the controller that dies: it says nothing then."""
    bus: bool = True
    """Whether the twin is still there to be asked afterwards."""


def _ip(*words: str) -> None:
    subprocess.run(["ip", "link", "set", CHANNEL, *words], check=True)


def _stand_still(number: int) -> None:
    os.kill(number, signal.SIGSTOP)
    time.sleep(0.1)
    os.kill(number, signal.SIGCONT)


def _fill_queue(_: Processes) -> None:
    # A queue of three frames that stay in it for minutes: sends fail with ENOBUFS from the fourth on.
    subprocess.run(["tc", "qdisc", "add", "dev", CHANNEL, "root", "netem", "limit", "3", "delay", "200s"], check=True)


def _empty_queue(_: Processes) -> None:
    subprocess.run(["tc", "qdisc", "del", "dev", CHANNEL, "root"], check=True)


FAULTS = (
    Fault("link down", lambda _: _ip("down"), "bus-off", lambda _: _ip("up"), bus=False),
    Fault("bus-off", lambda _: send_bus_off(), "bus-off", idle=True),
    Fault("ENOBUFS", _fill_queue, "bus-error", _empty_queue, bus=False),
    Fault("controller stopped", lambda p: _stand_still(p.controller), "stalled", idle=True),
    Fault("controller killed", lambda p: os.kill(p.controller, signal.SIGKILL), "", idle=True, killed=True),
    Fault("watchdog killed", lambda p: os.kill(p.watchdog, signal.SIGKILL), "watchdog"),
    Fault("watchdog stopped", lambda p: os.kill(p.watchdog, signal.SIGSTOP), "watchdog"),
    Fault("twin killed", lambda p: os.kill(p.twin, signal.SIGKILL), "position-lost", bus=False),
    Fault(
        "twin stopped",
        lambda p: os.kill(p.twin, signal.SIGSTOP),
        "position-lost",
        lambda p: os.kill(p.twin, signal.SIGCONT),
    ),
)
NAMES = ("whole", *(fault.name for fault in FAULTS))


def _say(flight: str, wrong: list[str], **measured: Any) -> bool:
    print("FLIGHT", json.dumps({"flight": flight, "wrong": wrong, **measured}), flush=True)
    return not wrong


@contextmanager
def _twin() -> Iterator[subprocess.Popen[str]]:
    """A twin on the bus that has said that it is there; it takes the letters of its pendant from a pipe."""
    command = [sys.executable, "-m", "jaxmpc", "twin", "--gap", "0.006", *_BUS]
    log = Path("/tmp/twin.log").open("w+")  # a pipe that nobody reads would stop it
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT, text=True)
    end = time.monotonic() + HUNG
    while "pendant:" not in Path(log.name).read_text():
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"no twin: {Path(log.name).read_text()}")
        time.sleep(0.05)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        log.close()


def _controller(duration: float) -> subprocess.Popen[str]:
    digest = hashlib.sha256(CONTROLLER.read_bytes()).hexdigest()
    command = [sys.executable, "-m", "jaxmpc", "run", str(CONTROLLER), *_BUS, "--arm", digest, "--start", "auto"]
    command += ["--reference", f"0,0,{WANTED:g}", "--rate", "10", "--duration", f"{duration:g}", "--record"]
    command += ["--output", str(FOLDER)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def _watchdog_of(controller: int) -> int:
    """The child of a controller."""
    return int(Path(f"/proc/{controller}/task/{controller}/children").read_text().split()[0])


def _fly(twin: subprocess.Popen[str], fault: Fault | None) -> tuple[list[tuple[float, str]], int, float]:
    """Its lines with their times [s], its exit code, and when the fault struck [s]."""
    run = _controller(2.0 * HELD if fault is None else HUNG)
    assert run.stdout is not None
    assert twin.stdin is not None
    said, struck = [], 0.0
    processes = None
    try:
        for text in run.stdout:
            line = text.rstrip()
            said.append((time.time(), line))
            if line.startswith("armed:"):
                time.sleep(0.2)
                twin.stdin.write("a")
                twin.stdin.flush()
            if line.startswith("contact:") and fault is not None:
                processes = Processes(twin.pid, run.pid, _watchdog_of(run.pid))
                time.sleep(PRESSED_FOR)
                struck = time.time()
                fault.strike(processes)
        return said, run.wait(), struck
    finally:
        run.kill()
        run.wait()
        if fault is not None and processes is not None:
            fault.undo(processes)


def _recorded() -> dict[str, Any]:
    newest = max(FOLDER.glob("*.npz"), key=lambda path: path.name)
    recording = read(newest)
    return {"header": recording.header, **recording.signals}


def whole() -> bool:
    """Start-up, tare, approach, contact, the wanted force, retraction; and how punctual the loop was."""
    with _twin() as twin:
        said, code, _ = _fly(twin, None)
    text = "\n".join(line for _, line in said)
    wrong = [f"exit code {code}"] if code else []
    where = 0
    for word in STORY:
        found = text.find(word, where)
        wrong += [f"no {word!r} after what came before"] if found < 0 else []
        where = max(where, found)
    measured: dict[str, Any] = {}
    for name in ("periods", "lateness", "compute"):
        if row := re.search(rf"^{name} +(.*)$", text, re.MULTILINE):
            _, _, largest, _, median, most = map(float, row[1].split())
            measured[name] = {"median": median, "99 %": most, "largest": largest}
    if row := re.search(r"overruns (\d+).*cycles missed (\d+)", text):
        measured |= {"overruns": int(row[1]), "missed": int(row[2])}
    if not wrong:
        recording = _recorded()
        contact = recording["state"][:, 0] == recording["header"]["names"]["state"].index("contact")
        pressed = recording["force"][contact][-round(HELD / recording["header"]["T_s"]) :, 2]
        measured |= {"cycles": len(contact), "in contact": int(contact.sum()), "mean force": round(pressed.mean(), 3)}
        wrong += [] if abs(pressed.mean() - WANTED) < 0.25 else [f"mean force {pressed.mean():.2f} N, not {WANTED:g} N"]
    if wrong:
        print(text, Path("/tmp/twin.log").read_text(), sep="\n")
    return _say("whole", wrong, **measured)


def struck(fault: Fault) -> bool:
    """A fault in contact: named in time, let go in time, nothing that drives afterwards."""
    mode = None
    with _twin() as twin:
        tap = BusTap()
        said, code, at = _fly(twin, fault)
        if fault.bus:
            mode = tap.safety_mode()
        driven, idled = [each for each in tap.driven() if each > at], tap.idled(at)
        tap.close()
    text = "\n".join(line for _, line in said)
    wrong = [] if at else ["it never came to contact"]
    measured: dict[str, Any] = {"exit": code, "last drive [ms]": round(1e3 * (max(driven, default=at) - at), 1)}
    if not fault.killed:
        stopped = next((when for when, line in said if line.startswith("FAULT") and when > at), None)
        measured["named [ms]"] = stopped and round(1e3 * (stopped - at), 1)
        wrong += [] if stopped is not None and stopped - at < NAMED else ["not named within a second"]
        ended = next((line for _, line in said if line.startswith("ended:")), "no last line")
        measured["ended"] = ended.removeprefix("ended: ")
        wrong += [] if f"fault, {fault.reason} " in f"{ended} " else [f"ended with {ended!r}"]
        wrong += [] if code == 1 else [f"exit code {code}"]
    if idled is not None:
        measured["idle [ms]"] = round(1e3 * (idled - at), 1)
    if fault.idle:
        wrong += [] if idled is not None and idled - at < LET_GO else [f"not idle within {1e3 * LET_GO:g} ms"]
        wrong += (
            [] if idled is not None and not [each for each in driven if each > idled + 0.001] else ["driven after it"]
        )
    wrong += [] if max(driven, default=at) - at < NAMED else ["driven a second later"]
    wrong += [f"safety module in mode {mode}"] if fault.bus and mode != 1 else []
    if wrong:
        print(text, Path("/tmp/twin.log").read_text(), sep="\n")
    return _say(fault.name, wrong, **measured)


def main() -> int:
    """All of them, or those that are named; 1 if one went wrong."""
    named = os.environ.get("FLIGHTS", "")
    well = True
    for fault in (None, *FAULTS):
        if named and (fault.name if fault else "whole") not in named.split(","):
            continue
        shutil.rmtree(FOLDER, ignore_errors=True)
        try:
            well = (struck(fault) if fault else whole()) and well
        except Exception as error:  # the other flights are still worth their time
            well = _say(fault.name if fault else "whole", [f"{type(error).__name__}: {error}"])
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
