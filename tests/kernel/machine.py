"""The guest's computer: QEMU without KVM, whose time is the number of instructions it has executed.

A nanosecond an instruction, and nothing while it sleeps: the same flight takes the same virtual time on any host,
however busy. So deadlines of a millisecond can be met where real ones could not.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from threading import Timer

from tests.kernel.initramfs import version_of

MEMORY_MB = 1536
QEMU = "qemu-system-x86_64"
_APPEND = "console=ttyS0 quiet loglevel=3 panic=-1 tsc=reliable mitigations=off random.trust_cpu=on"


def lines(kernel: Path, archive: Path, seconds: float) -> Iterator[str]:
    """Boot, and yield what the guest writes until it powers off.

    Args:
        kernel: Unpacked package `linux-image-…`.
        archive: Its initramfs.
        seconds: Patience, of the host [s]; then it is ended.
    """
    command = [QEMU, "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-serial", "stdio"]
    command += ["-machine", "q35", "-accel", "tcg", "-cpu", "max", "-m", str(MEMORY_MB), "-smp", "1"]
    command += ["-icount", "shift=0,sleep=off", "-append", _APPEND]
    command += ["-kernel", str(kernel / "boot" / f"vmlinuz-{version_of(kernel)}"), "-initrd", str(archive)]
    machine = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    timer = Timer(seconds, machine.kill)
    timer.start()
    try:
        assert machine.stdout is not None
        for line in machine.stdout:
            yield line.rstrip()
    finally:
        timer.cancel()
        machine.kill()
        machine.wait()
