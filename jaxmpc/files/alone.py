"""A folder of results for one process at a time: of two jobs that begin within seconds neither finds the other's files.

The lock is on the folder itself and ends with its process, by `kill -9` too, so nothing is left that would refuse the
next one.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxmpc.files.errors import InputError


@contextmanager
def alone_in(folder: Path | None) -> Iterator[None]:
    """Hold a folder for as long as the context lasts; made if it is not there.

    Args:
        folder: Of the results; None holds nothing.

    Raises:
        InputError: Another process holds it, or a file is in its place.
        OSError: It cannot be made or opened.
    """
    if folder is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        remedy = "A file is in its place: choose another with -o."
        raise InputError("output folder", folder, "a folder", remedy) from None
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            remedy = "Another job is at work there: wait until it ends, or choose another with -o."
            raise InputError("output folder", folder, "a folder of no running job", remedy) from None
        except OSError:
            # Some network file systems lock no folder: there it is as if nobody else were there.
            pass
        yield
    finally:
        os.close(descriptor)
