"""`make kernel-test`: flights on the kernel's own CAN, in a virtual machine.

On each kernel whose package lies in a folder: a standard one and one with PREEMPT_RT are meant.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tests.kernel import initramfs, machine
from tests.kernel.flights import NAMES

TOOLS = {
    machine.QEMU: "qemu-system-x86",
    "busybox": "busybox-static",
    "depmod": "kmod",
    "modprobe": "kmod",
    "ip": "iproute2",
    "tc": "iproute2",
    "cpio": "cpio",
    "cc": "gcc",
    "dpkg-deb": "dpkg",
}
"""Programs and the Debian packages that hold them."""
DILATE = 10
"""Instructions that a nanosecond of the programs' time has: a processor of today."""


def main() -> int:
    """Fly; 0 also where it cannot be done here, after a word why."""
    parser = argparse.ArgumentParser(prog="tests.kernel", description=__doc__.splitlines()[0])
    parser.add_argument("--kernels", type=Path, default=initramfs.ROOT / "build/kernels", metavar="DIR")
    parser.add_argument("--flights", default="", help="only these, with commas between them")
    parser.add_argument("--controller", type=Path, help="a frozen one; else `cautious` is frozen now")
    parser.add_argument("--minutes", type=float, default=180.0, help="patience with one machine (180)")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="virtual machines at once, 2 GB each (the processors)"
    )
    args = parser.parse_args()
    tools = {tool: package for tool, package in TOOLS.items() if _missing(tool)}
    packages = sorted(args.kernels.glob("linux-image-*.deb"))
    if tools:
        print(
            f"kernel-test: skipped, {', '.join(tools)} not found: apt install {' '.join(sorted(set(tools.values())))}"
        )
        return 0
    if not packages:
        print(
            f"kernel-test: skipped, no kernel in {args.kernels}: there, `apt-get download` the packages on which "
            "linux-image-amd64 and linux-image-rt-amd64 depend (apt-cache depends names them)"
        )
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # or the machines would go on without us
    names = args.flights.split(",") if args.flights else list(NAMES)
    parts = max(1, min(args.jobs // len(packages), len(names)))
    with tempfile.TemporaryDirectory(prefix="jaxmpc-kernel-") as made, ThreadPoolExecutor(args.jobs) as pool:
        folder = Path(made)
        controller = args.controller or _frozen(folder)
        guests = []
        for package in packages:
            kernel = folder / package.stem
            subprocess.run(["dpkg-deb", "-x", str(package), str(kernel)], check=True)
            guests += [Guest(kernel, tuple(names[part::parts]), part) for part in range(parts)]
        print(f"one instruction a nanosecond, {DILATE} of them in one of the programs' time", flush=True)
        return 0 if all(list(pool.map(lambda guest: _flown(guest, folder, controller, args.minutes), guests))) else 1


class Guest(NamedTuple):
    """A virtual machine to be: an unpacked kernel package, its share of the flights, and which share that is."""

    kernel: Path
    flights: tuple[str, ...]
    part: int


def _missing(tool: str) -> bool:
    return shutil.which(tool, path="/usr/local/bin:/usr/sbin:/sbin:/usr/bin:/bin") is None


def _frozen(folder: Path) -> Path:
    path = folder / "controller.npz"
    command = [sys.executable, "-m", "jaxmpc", "freeze", "cautious", "--experiment", "table-1-wam", "-o", str(path)]
    subprocess.run(command, check=True, cwd=initramfs.ROOT)
    return path


def _flown(guest: Guest, folder: Path, controller: Path, minutes: float) -> bool:
    """Flights of a guest, told one by one."""
    version, began = initramfs.version_of(guest.kernel), time.monotonic()
    inside = folder / f"guest-{version}-{guest.part}"
    inside.mkdir()
    settings = {"DILATE": DILATE, "FLIGHTS": ",".join(guest.flights)}
    archive = initramfs.build(inside, guest.kernel, controller, settings)
    well, told, ended = True, 0, False
    for line in machine.lines(guest.kernel, archive, 60.0 * minutes):
        word, _, rest = line.partition(" ")
        if word == "FLIGHT":
            said = json.loads(rest)
            wrong, name = said.pop("wrong"), said.pop("flight")
            told, well = told + 1, well and not wrong
            minute = (time.monotonic() - began) / 60.0
            print(f"{version} {minute:5.1f} min  {'WRONG ' if wrong else 'well  '} {name:<20} {_short(said)}")
            print("".join(f"             {each}\n" for each in wrong), end="", flush=True)
        elif line.startswith("init: flights ended"):
            ended = True
        else:
            print(f"{version} | {line}", flush=True)
    shutil.rmtree(inside)
    if not (told == len(guest.flights) and ended):
        print(f"{version}: {told} of {len(guest.flights)} flights told within {minutes:g} minutes", flush=True)
    return well and told == len(guest.flights) and ended


def _short(said: dict[str, object]) -> str:
    return ", ".join(
        f"{key} {_short(value) if isinstance(value, dict) else value}"
        for key, value in said.items()
        if value is not None
    )


if __name__ == "__main__":
    sys.exit(main())
