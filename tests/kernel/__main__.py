"""`make kernel-test`: flights on the kernel's own CAN, in a virtual machine.

On each kernel whose package lies in a folder: a standard one and one with PREEMPT_RT are meant.
"""

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.kernel import initramfs, machine

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
    parser.add_argument("--minutes", type=float, default=90.0, help="patience with one kernel (90)")
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
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # or the machine would go on without us
    well = True
    with tempfile.TemporaryDirectory(prefix="jaxmpc-kernel-") as made:
        folder = Path(made)
        controller = args.controller or _frozen(folder)
        for package in packages:
            kernel = folder / package.stem
            subprocess.run(["dpkg-deb", "-x", str(package), str(kernel)], check=True)
            well = _flown(folder, kernel, controller, args.flights, args.minutes) and well
            shutil.rmtree(kernel)
    return 0 if well else 1


def _missing(tool: str) -> bool:
    return shutil.which(tool, path="/usr/local/bin:/usr/sbin:/sbin:/usr/bin:/bin") is None


def _frozen(folder: Path) -> Path:
    path = folder / "controller.npz"
    command = [sys.executable, "-m", "jaxmpc", "freeze", "cautious", "--experiment", "table-1-wam", "-o", str(path)]
    subprocess.run(command, check=True, cwd=initramfs.ROOT)
    return path


def _flown(folder: Path, kernel: Path, controller: Path, flights: str, minutes: float) -> bool:
    """All flights on one kernel, told one by one."""
    version, began = initramfs.version_of(kernel), time.monotonic()
    print(f"{version}: one instruction a nanosecond, {DILATE} of them in one of the programs' time", flush=True)
    inside = folder / "guest"
    inside.mkdir()
    archive = initramfs.build(inside, kernel, controller, {"DILATE": DILATE, "FLIGHTS": flights})
    well, told, ended = True, 0, False
    for line in machine.lines(kernel, archive, 60.0 * minutes):
        word, _, rest = line.partition(" ")
        if word == "FLIGHT":
            said = json.loads(rest)
            wrong, name = said.pop("wrong"), said.pop("flight")
            told, well = told + 1, well and not wrong
            minute = (time.monotonic() - began) / 60.0
            print(f"  {minute:5.1f} min  {'WRONG ' if wrong else 'well  '} {name:<20} {_short(said)}")
            print("".join(f"             {each}\n" for each in wrong), end="", flush=True)
        elif line.startswith("init: flights ended"):
            ended = True
        else:
            print(f"  | {line}", flush=True)
    shutil.rmtree(inside)
    if not (told and ended):
        print(f"  the guest did not come to its end within {minutes:g} minutes, or not at all")
    return well and told > 0 and ended


def _short(said: dict[str, object]) -> str:
    return ", ".join(
        f"{key} {_short(value) if isinstance(value, dict) else value}"
        for key, value in said.items()
        if value is not None
    )


if __name__ == "__main__":
    sys.exit(main())
