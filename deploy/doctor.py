"""What stands between this machine and a run: looked at and measured, nothing assumed, nothing moved."""

import argparse
import hashlib
import os
import platform
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Literal, NamedTuple

from deploy import doctor_startup
from deploy.bus.bus import Bus
from deploy.bus.interface import open_bus
from deploy.controller.artifact import Artifact
from deploy.controller.file import ArtifactError, load
from deploy.controller.limits import Limits
from deploy.doctor_pucks import torque_caps
from deploy.errors import BusError
from deploy.loop.realtime import MonotonicClock, next_deadline, prepared
from deploy.loop.statistics import LATE_OVERRUNS, Histogram
from deploy.puck.codec import PUCKS, SAFETY_MODULE, SENSOR, decode, get
from deploy.puck.messages import PropertyReply
from deploy.puck.properties import MODE, STAT, STAT_ERROR, STAT_READY

HIGHEST_LOAD = 0.9
"""Share of the bus that may be planned with frames of the worst length: the rest is adapters and the unexpected."""
BIT_RATE = 1_000_000
POLLS = 50.0
"""How often states are asked for besides positions and force [1/s]."""
_LISTEN_S, _ANSWER_S = 0.2, 0.02


class Finding(NamedTuple):
    """One thing that was looked at."""

    level: Literal["ok", "note", "wrong"]
    """`wrong` prevents a run; `note` is worth knowing."""
    text: str


class Traffic(NamedTuple):
    """What is on the bus in a cycle."""

    joints: int = 4
    sensor: bool = True
    """Whether the force sensor is on the bus too."""
    polls: float = 0.0
    """Questions for a state, per cycle."""

    @property
    def microseconds(self) -> float:
        """Time on the bus at 1 Mbit/s with as many stuff bits as there can be [µs]."""
        core = bits(1) + self.joints * bits(3) + -(-self.joints // 4) * bits(8)
        force = bits(1) + bits(6) + bits(7) if self.sensor else 0
        return core + force + self.polls * (bits(1) + bits(6))

    @property
    def highest_rate(self) -> float:
        """Cycles that may be planned [1/s]."""
        return HIGHEST_LOAD * BIT_RATE / self.microseconds


def bits(n: int) -> int:
    """Longest frame with n data bytes, with the space after it: 47 + 8n bits, and a stuff bit for each four of 34 + 8n.

    All but the delimiters and the space is stuffed; after the first five equal bits each stuff bit can begin the next
    four (Davis et al., Controller Area Network schedulability analysis, 2007).
    """
    return 8 * n + 47 + (8 * n + 33) // 4


def budget(joints: int, sensor: bool, rate: float) -> tuple[list[str], Finding]:
    """The table of what a cycle costs, and whether the wanted one fits.

    Args:
        joints: 4 or 7.
        sensor: Whether the force sensor is on the bus.
        rate: Cycles [1/s].
    """
    wanted = Traffic(joints, sensor, POLLS / rate)
    rows = {
        "4 joints": Traffic(4, False),
        "4 joints, force sensor": Traffic(4, True),
        "4 joints, force sensor, state in every cycle": Traffic(4, True, 1.0),
        "7 joints": Traffic(7, False),
        "7 joints, force sensor": Traffic(7, True),
        f"this run: {joints} joints{', force sensor' if sensor else ''}, states at {POLLS:g} Hz": wanted,
    }
    lines = [f"{'bus at 1 Mbit/s, longest frames':<50}{'µs':>8}{'load':>7}{'at most':>11}"]
    for name, row in rows.items():
        load_, most = 1e-6 * row.microseconds * rate, row.highest_rate
        verdict = "" if rate <= most else "   too much"
        lines.append(f"{name:<50}{row.microseconds:>8.0f}{load_:>7.0%} {most:>7.0f} Hz{verdict}")
    if rate <= wanted.highest_rate:
        return lines, Finding("ok", f"bus budget: {rate:g} Hz takes {1e-6 * wanted.microseconds * rate:.0%} of the bus")
    text = f"bus budget: {rate:g} Hz would take {1e-6 * wanted.microseconds * rate:.0%} of the bus, above 90 %"
    return lines, Finding("wrong", f"{text}: run at {wanted.highest_rate:.0f} Hz or slower")


def versions() -> list[Finding]:
    """Report the versions of Python, of the packages and of the kernel."""
    found = [Finding("ok", f"python {platform.python_version()}, {platform.system()} {platform.release()}")]
    for name, need in (("numpy", True), ("python-can", True), ("mujoco", False), ("jax", False)):
        try:
            found.append(Finding("ok", f"{name} {metadata.version(name)}"))
        except metadata.PackageNotFoundError:
            text = f"{name}: not installed" + ("" if need else "; only the twin and the simulator need it")
            found.append(Finding("wrong" if need else "ok", text))
    if sys.platform == "linux" and "PREEMPT_RT" not in platform.version():
        found.append(Finding("note", "kernel: not PREEMPT_RT; single cycles can be late by milliseconds"))
    governor = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if governor.exists() and (kind := governor.read_text().strip()) != "performance":
        text = f"processor: the governor is {kind}; `cpupower frequency-set -g performance` keeps it awake"
        found.append(Finding("note", text))
    return found


def machine(rate: float, seconds: float = 1.0, clock: MonotonicClock | None = None) -> list[Finding]:
    """What the system grants of real time, then how punctual waits are under it.

    Args:
        rate: Waits [1/s].
        seconds: For how long.
        clock: That waits.
    """
    clock = clock or MonotonicClock()
    period = round(1e9 / rate)
    lateness, late = Histogram(), 0
    with prepared() as granted:
        deadline = clock.now() + period
        for _ in range(round(seconds * rate)):
            clock.wait_until(deadline)
            now = clock.now()
            lateness.add(now - deadline)
            deadline, missed = next_deadline(deadline, now, period)
            late += missed > 0
    found = [Finding("ok" if each.ok else "note", each.sentence) for each in granted]
    resolution = 1e9 * time.get_clock_info("monotonic").resolution
    found.append(Finding("ok", f"clock: monotonic, resolution {resolution:g} ns"))
    text = f"waits of {period / 1e6:g} ms end late by {lateness.quantile(0.5):.0f} µs (median), "
    text += f"{lateness.quantile(0.99):.0f} µs (99 %), {lateness.most:.0f} µs (most)"
    if late >= LATE_OVERRUNS * max(seconds, 1.0):
        return [*found, Finding("wrong", f"{text}; {late} missed a whole cycle: a run would stop with the reason late")]
    return [*found, Finding("note" if late else "ok", text + (f"; {late} missed a whole cycle" if late else ""))]


def jr3(needed: bool, devices: Path = Path("/dev")) -> Finding:
    """Whether there is a comedi device for a JR3.

    Args:
        needed: Whether the run is to use it.
        devices: Folder of devices.
    """
    found = sorted(devices.glob("comedi*"))
    if not found:
        text = "JR3: no /dev/comedi*"
        remedy = ": load the driver by `modprobe jr3_pci`, with its firmware jr3pci.idm, or use Barrett's sensor"
        return Finding("wrong", text + remedy) if needed else Finding("ok", f"{text}, not used")
    shut = [path.name for path in found if not os.access(path, os.R_OK | os.W_OK)]
    if len(shut) == len(found):
        text = f"JR3: {', '.join(shut)} may not be opened: join the group that owns it (`ls -l /dev/comedi*`)"
        return Finding("wrong" if needed else "note", text)
    return Finding("ok", f"JR3: {', '.join(path.name for path in found)}; filters and scale are read at the start")


def controller(path: Path) -> tuple[Finding, Artifact | None]:
    """Whether a file is a controller that may drive the arm."""
    try:
        artifact = load(path)
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    except (ArtifactError, OSError) as error:
        return Finding("wrong", f"controller: {error}"), None
    if artifact.arm is None:
        text = f"controller: {path} is of the kind {artifact.kind!r}, which only replays: freeze it with table-1-wam"
        return Finding("wrong", text), artifact
    drives = f"drives a {artifact.arm.robot} at {1.0 / artifact.T_s:g} Hz"
    return Finding("ok", f"controller: {path} {drives}, sha256 {sha256}"), artifact


def bus(flags: argparse.Namespace, sensor: bool, limits: Limits | None = None) -> list[Finding]:
    """Whether the bus is there, quiet, and who answers on it; it asks for states and sets nothing.

    Args:
        flags: Of python-can.
        sensor: Whether the force sensor must answer.
        limits: Of the controller that is to run; None for none.
    """
    try:
        opened = open_bus(flags)
    except BusError as error:
        return [Finding("wrong", f"bus: {error}")]
    try:
        return _ask(opened, sensor, limits)
    finally:
        opened.close()


def _ask(opened: Bus, sensor: bool, limits: Limits | None) -> list[Finding]:
    end = time.monotonic() + _LISTEN_S
    while time.monotonic() < end:
        opened.receive(_ANSWER_S)
    if opened.counters.hosts:
        heard = f"{opened.counters.hosts} frames of another controller within {_LISTEN_S:g} s"
        return [Finding("wrong", f"bus: {heard}: stop it first; nothing was asked")]
    opened.listen_to(range(1, 32))
    nodes = (*PUCKS, SENSOR, SAFETY_MODULE)
    states = {node: state for node in nodes if (state := _property(opened, node, STAT)) is not None}
    if opened.state != "active":
        return [Finding("wrong", f"bus: frames could not be sent (it is {opened.state}): {opened.remedy}")]
    if not states:
        text = "bus: open, but nobody answers: check power, e-stop, bit rate (1 Mbit/s) and termination"
        return [Finding("wrong", text)]
    found = [Finding("ok", f"bus: open; nodes {', '.join(map(str, states))} answer")]
    if silent := [node for node in PUCKS if node not in states]:
        found.append(Finding("wrong", f"bus: pucks {', '.join(map(str, silent))} do not answer: power, e-stop, cables"))
    if broken := [node for node in (*PUCKS, *[SENSOR] * sensor) if states.get(node) == STAT_ERROR]:
        remedy = "switch the arm off and on; if it stays, ask btutil"
        found.append(Finding("wrong", f"bus: nodes {', '.join(map(str, broken))} report an error (STAT 1): {remedy}"))
    if limits is not None and all(states.get(node) == STAT_READY for node in PUCKS):
        fine, text = torque_caps(limits, lambda node, number: _property(opened, node, number))
        found += [Finding("note" if fine else "wrong", text)] * bool(text)
    told = doctor_startup.refused(lambda node, number: _property(opened, node, number), states)
    found += [Finding(level, text) for level, text in told]
    if SENSOR not in states and sensor:
        found.append(Finding("wrong", "bus: the force sensor (node 8) does not answer: its cable, or --sensor jr3"))
    if SAFETY_MODULE not in states:
        found.append(Finding("wrong", "bus: the safety module (node 10) does not answer: is the pendant connected?"))
    elif (mode := _property(opened, SAFETY_MODULE, MODE)) == 0:
        found.append(Finding("note", "safety module: e-stop; release it and press Shift-idle before a run"))
    elif mode == 2:
        found.append(Finding("wrong", "safety module: active, the arm may move: press Shift-idle"))
    else:
        found.append(Finding("ok", "safety module: idle"))
    return found


def _property(opened: Bus, node: int, number: int) -> int | None:
    """What a node answers to a question, if it does in time."""
    opened.send(get(node, number))
    end = time.monotonic() + _ANSWER_S
    while (left := end - time.monotonic()) > 0.0:
        if (received := opened.receive(left)) is None:
            continue
        answer = decode(received[0])
        if isinstance(answer, PropertyReply) and (answer.node, answer.property) == (node, number):
            return answer.value
    return None
