"""Who works on what in a folder that several processes share, on one machine or on many.

    leases/000000512-000001024.json   planned rows 512 … 1023 are being computed; touched every few seconds
    aside/000000512-000001024.json    they are given up: why

A lease is made by creating its file, which a file system does for one process alone. A silent lease is no longer one:
its age is told against a file touched in the same folder, never against this machine's clock. On its own machine a
process also sees at once that the owner is gone. A lease that is broken or taken twice costs double work, nothing else.
"""

import json
import os
import threading
import uuid
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from jaxmpc.files.foreign import table_if_any
from jaxmpc.files.sealed import write_atomic
from sweeps.chunks import chunk_name, stretch_of

SILENCE = 60.0
"""After so long without a sign of life a lease is no longer one [s]."""
MOST_DEATHS = 3
"""So many owners may die of one chunk, once they have shown that they can compute."""
MOST_EARLY_DEATHS = 10
"""The same of owners that had not computed anything yet, which die of much else."""

Stretch = tuple[int, int]


class Lease(NamedTuple):
    """What a lease says."""

    owner: str
    machine: str
    """Digest-like name of boot and process namespace; no host name."""
    pid: int
    warm: bool
    """Whether the owner has computed something before."""
    deaths: int
    early: int
    """Owners that died of this chunk: those that were warm, and the others."""


class Leases:
    """The leases of a folder, as one process has them.

    Args:
        folder: The sweep's.
        silence: After so long without a sign of life others take a lease for broken [s].
    """

    def __init__(self, folder: Path, silence: float = SILENCE) -> None:
        self._folder, self._aside = folder / "leases", folder / "aside"
        self._folder.mkdir(exist_ok=True)
        self._silence = silence
        self._me = uuid.uuid4().hex
        self._mine: set[Stretch] = set()
        self.warm = False
        self._stop = threading.Event()
        self._beat = threading.Thread(target=self._keep_alive, daemon=True)
        self._beat.start()

    def close(self) -> None:
        """Give everything back."""
        self._stop.set()
        self._beat.join()
        for stretch in list(self._mine):
            self.release(stretch)

    def others(self) -> list[Stretch]:
        """Stretches on which somebody else works; of the dead it keeps count, see `take`."""
        return [stretch for stretch in self._listed() if stretch not in self._mine and self._alive(stretch)]

    def given_up(self) -> dict[Stretch, str]:
        """Stretches that are set aside, and why."""
        return given_up(self._aside.parent)

    def retry(self) -> None:
        """Take up again what was set aside."""
        for stretch in self.given_up():
            (self._aside / f"{chunk_name(*stretch)}.json").unlink(missing_ok=True)

    def set_aside(self, stretch: Stretch, reason: str) -> None:
        """Give a stretch up.

        Raises:
            OSError: The folder cannot be written.
        """
        self._aside.mkdir(exist_ok=True)
        write_atomic(self._aside / f"{chunk_name(*stretch)}.json", json.dumps({"reason": reason}).encode())

    def take(self, stretch: Stretch) -> bool:
        """Whether the stretch is now this process's: nobody alive had it, and it has not killed too many.

        Raises:
            OSError: The folder cannot be written.
        """
        deaths = early = 0
        for other in self._listed():
            if other in self._mine or not (other[0] < stretch[1] and stretch[0] < other[1]):
                continue
            if self._alive(other):
                return False
            # The dead one's file goes; who died of what is carried on.
            lease = self._lease(other)
            if lease is not None:
                deaths = max(deaths, lease.deaths + lease.warm)
                early = max(early, lease.early + (not lease.warm))
            self._path(other).unlink(missing_ok=True)
            if deaths >= MOST_DEATHS or early >= MOST_EARLY_DEATHS:
                self.set_aside(other, f"{deaths + early} processes died while they computed it")
                return False
        content = Lease(self._me, _machine(), os.getpid(), self.warm, deaths, early)
        try:
            handle = os.open(self._path(stretch), os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            return False
        with os.fdopen(handle, "w") as file:
            file.write(json.dumps(content._asdict()))
        self._mine.add(stretch)
        return True

    def release(self, stretch: Stretch) -> None:
        """Give a stretch back, done or not."""
        self._mine.discard(stretch)
        lease = self._lease(stretch)
        # Who slept too long has lost it to another.
        if lease is not None and lease.owner == self._me:
            self._path(stretch).unlink(missing_ok=True)

    def _keep_alive(self) -> None:
        while not self._stop.wait(self._silence / 8.0):
            for stretch in list(self._mine):
                with suppress(OSError):
                    os.utime(self._path(stretch))

    def _path(self, stretch: Stretch) -> Path:
        return self._folder / f"{chunk_name(*stretch)}.json"

    def _listed(self) -> list[Stretch]:
        found = (stretch_of(path.name) for path in sorted(self._folder.glob("[0-9]*.json")))
        return [stretch for stretch in found if stretch is not None]

    def _lease(self, stretch: Stretch) -> Lease | None:
        try:
            lease = Lease(**table_if_any(self._path(stretch)))
        except TypeError:
            return None
        typed = all(type(value) is Lease.__annotations__[name] for name, value in lease._asdict().items())
        return lease if typed and 0 < lease.pid < 2**31 else None

    def _alive(self, stretch: Stretch) -> bool:
        """Whether the owner of a lease gives signs of life."""
        lease = self._lease(stretch)
        if lease is not None and lease.machine == _machine():
            try:
                os.kill(lease.pid, 0)
            except ProcessLookupError:
                return False
            except PermissionError:
                pass
        probe = self._folder / f".probe-{self._me}"
        try:
            probe.touch()
            age = probe.stat().st_mtime - self._path(stretch).stat().st_mtime
        except FileNotFoundError:
            return False
        finally:
            probe.unlink(missing_ok=True)
        return age < self._silence


def given_up(folder: Path) -> dict[Stretch, str]:
    """Stretches of a sweep's folder that are set aside, and why."""
    found = {}
    for path in sorted((folder / "aside").glob("[0-9]*.json")):
        if (stretch := stretch_of(path.name)) is not None:
            found[stretch] = str(table_if_any(path).get("reason", "unknown"))
    return found


def _machine() -> str:
    """What tells machines, and the process numbers of containers, apart."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip() + os.readlink("/proc/self/ns/pid")
    except OSError:
        return f"{uuid.getnode():x}"
