"""The file of a flight recording: opened, and its space reserved, before the arm moves.

    open: folder/.flight-0000.npz.part, reserved ─► save: written, renamed to flight-0000.npz
                                                 └► close: removed

So a full disk, a folder that is a file or one that may not be written is found while nothing moves yet. What happens to
the folder meanwhile is met by writing anew: there, else in the folder for temporary files, else in the current one.
"""

import errno
import fcntl
import os
import tempfile
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import NamedTuple

from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import write_atomic


class Saved(NamedTuple):
    """What became of a recording."""

    ok: bool
    """Whether it lies in the folder that was asked for."""
    sentence: str


class RecordingFile:
    """A file for one recording, whose space nobody else can take any more.

    Attributes:
        path: Where the recording will be.
    """

    def __init__(self, folder: Path, size: int, key: str = "--output") -> None:
        """Make the folder if need be, and reserve the space.

        Args:
            folder: Of the recordings.
            size: Of the largest recording [bytes].
            key: What the folder was given by.

        Raises:
            InputError: The folder cannot be made or written, or there is too little space on its disk.
        """
        self._folder, self._descriptor = folder, -1
        self._made = [each for each in (folder, *folder.parents) if not each.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.path, self._part, self._descriptor = _reserved(folder)
            os.posix_fallocate(self._descriptor, 0, size)
        except OSError as error:
            self.close()
            bound = f"a folder in which {size} bytes can be written ({error.strerror})"
            raise InputError(key, folder, bound, "Choose another one, or make room there.") from None

    def save(self, data: bytes) -> Saved:
        """Write the recording; it never raises."""
        why = ""
        try:
            self._write(data)
            return Saved(True, f"{self.path}")
        except OSError as error:
            why = f"{self.path}: {error.strerror}"
        anew = (self._folder / self.path.name, Path(tempfile.gettempdir()) / self.path.name, Path(self.path.name))
        for path in anew:
            try:
                if path.parent == self._folder:
                    path.parent.mkdir(parents=True, exist_ok=True)
                path = _unused(path)
                write_atomic(path, data)
            except OSError as error:
                why += f"; {path}: {error.strerror}"
                continue
            return Saved(path.parent == self._folder, f"{path} ({why})")
        return Saved(False, f"LOST, for it could be written nowhere: {why}")

    def close(self) -> None:
        """Give the space back, and the folder if it was made here and is empty; safe to call again."""
        if self._descriptor >= 0:
            with suppress(OSError):
                if _is_at(self._descriptor, self._part):
                    self._part.unlink()
            with suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = -1
        with suppress(OSError):
            for folder in self._made:
                folder.rmdir()

    def _write(self, data: bytes) -> None:
        if self._descriptor < 0:
            raise OSError(errno.EBADF, "closed before")
        done = 0
        while done < len(data):
            done += os.pwrite(self._descriptor, data[done:], done)
        os.ftruncate(self._descriptor, len(data))
        os.fchmod(self._descriptor, 0o644)
        os.fsync(self._descriptor)
        if not _is_at(self._descriptor, self._part):
            raise OSError(errno.ENOENT, "its folder was replaced")
        if self.path.exists():
            raise OSError(errno.EEXIST, "somebody else has written it")
        os.rename(self._part, self.path)
        os.close(self._descriptor)
        self._descriptor = -1


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether an open file is what is found by a name."""
    return os.path.samestat(os.fstat(descriptor), os.stat(path))


def _reserved(folder: Path) -> tuple[Path, Path, int]:
    """A new recording's name, its part file, and a descriptor of it that is locked."""
    for number in count():
        path = folder / f"flight-{number:04d}.npz"
        if path.exists():
            continue
        part = folder / f".{path.name}.part"  # one that a killed program left is taken over
        descriptor = os.open(part, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                if _is_at(descriptor, part):
                    return path, part, descriptor
            os.close(descriptor)  # another program has finished it meanwhile
        except BlockingIOError:  # another program's
            os.close(descriptor)
        except OSError:
            os.close(descriptor)
            part.unlink(missing_ok=True)
            raise
    raise AssertionError


def _unused(path: Path) -> Path:
    """The path itself, or one with a number where it is taken."""
    if not path.exists():
        return path
    return next(other for i in count(1) if not (other := path.with_name(f"{path.stem}-{i}{path.suffix}")).exists())
