"""Where results go, looked at before anything is computed: who has waited for an hour must not learn then."""

import os
import stat
import tempfile
from pathlib import Path

from jaxmpc.files.errors import InputError


def check_file(key: str, path: Path | None, *suffixes: str) -> None:
    """Refuse a file that could not be written; makes nothing.

    Args:
        key: The option that named it.
        path: Of the file; None where none is asked for.
        suffixes: What it may end in; anything if none is given.

    Raises:
        InputError: It is a folder or device, its folder is missing or not writable, or it ends in something else.
    """
    if path is None:
        return
    if suffixes and path.suffix not in suffixes:
        raise InputError(key, path, f"a file ending in {', '.join(suffixes)}", "Rename it.")
    _check_name(key, path)
    try:
        if path.exists() and not stat.S_ISREG(path.stat().st_mode):
            raise InputError(key, path, "a file", "A folder or a device is in its place: choose another name.")
        if not path.name or not path.parent.is_dir():
            raise InputError(
                key, path, "a file that can be written, in a folder that exists", f"Make {path.parent} first."
            )
        _check_writable(path.parent)
        if path.exists() and not os.access(path, os.W_OK):
            raise InputError(key, path, "a file that may be written", "Choose another name.")
    except OSError as error:
        raise InputError(key, path, "a path that can be written", f"{error.strerror}.") from None


def check_folder(key: str, path: Path | None) -> None:
    """Refuse a folder that could not be made or written into; makes nothing.

    Args:
        key: The option that named it.
        path: Of the folder, or where it is to be made; None where none is asked for.

    Raises:
        InputError: A file is in its place or above it, or what is there may not be written.
    """
    if path is None:
        return
    _check_name(key, path)
    try:
        # A link to nothing does not exist, and no folder can be made in its place.
        there = next(each for each in (path, *path.absolute().parents) if each.exists() or each.is_symlink())
        if not there.is_dir():
            kind = "a file" if there.exists() else "a link to nothing"
            raise InputError(key, path, "a folder", f"{there} is {kind}: choose another with {key}.")
        _check_writable(there)
    except OSError as error:
        raise InputError(key, path, "a path that can be written", f"{error.strerror}.") from None


def _check_name(key: str, path: Path) -> None:
    if "\0" in str(path) or any(len(os.fsencode(part)) > 255 for part in path.parts):
        raise InputError(key, path, "a path whose names have at most 255 bytes, and no NUL", "Choose another name.")


def _check_writable(folder: Path) -> None:
    """Try it, as permissions alone do not tell; the file has no name and is gone at once."""
    with tempfile.TemporaryFile(dir=folder):
        pass
