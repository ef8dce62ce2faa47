"""Files that cannot change unnoticed: npz without pickle, closed by a sha256 over every byte before it."""

import hashlib
import io
import json
import math
import os
import re
import struct
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

SEAL = hashlib.sha256().digest_size
"""Length of the trailer [bytes]."""
LARGEST = 64 * 2**20
"""Largest file that is read [bytes]."""

LARGEST_CONTENTS = 2**20
"""Largest table of contents of its zip archive [bytes]; a file of ours has a dozen entries of 60."""
DEEPEST = 64
"""Deepest nesting of a header's lists and tables [-]; a family's has seven."""
_NAME = re.compile(r"(?!.*\.\.)\w[\w.\[\]() -]*(/\w[\w.\[\]() -]*)*\.npy", re.ASCII)
_KINDS = "biufcSU"
_END = struct.Struct("<4s4H2LH")
"""Last record of a zip archive without a comment; the sixth number is the size of the table of contents."""


class SealError(ValueError):
    """The file is not what was written; the message says what is wrong with it."""


def canonical_json(data: Any) -> str:
    """JSON text that is the same for the same data: sorted keys, no spaces, no NaN."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def digest(data: Any) -> str:
    """sha256 of plain data, in hexadecimal."""
    return hashlib.sha256(canonical_json(data).encode()).hexdigest()


def seal(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> bytes:
    """Header and arrays as sealed bytes; the same input gives the same bytes."""
    text = np.frombuffer(canonical_json(header).encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, header=text, **{k: np.asarray(arrays[k], order="C") for k in sorted(arrays)})
    # In place: a chunk of a sweep is tens of megabytes, and a copy takes as long as its hash.
    with buffer.getbuffer() as body:
        found = hashlib.sha256(body).digest()
    buffer.seek(0, io.SEEK_END)
    buffer.write(found)
    return buffer.getvalue()


ARCHIVE = b"PK"
"""What an npz file begins with."""


def unseal(data: bytes, largest: int = LARGEST) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of sealed bytes; nothing is parsed before the seal is found intact.

    Args:
        data: As `seal` made them.
        largest: Most that are read [bytes].

    Raises:
        SealError: The bytes are too few or too many, were changed or cut short, or hold something else.
    """
    if len(data) <= SEAL:
        raise SealError(f"it has {len(data)} bytes, fewer than its seal alone: it was cut short")
    if len(data) > largest:
        raise SealError(f"it has {len(data)} bytes, more than the {largest} that are read")
    body, trailer = data[:-SEAL], data[-SEAL:]
    if hashlib.sha256(body).digest() != trailer:
        why = "it was changed or cut short after it was written"
        why += "" if data.startswith(ARCHIVE) else ", or is none of jaxmpc's sealed files"
        raise SealError(f"its sha256 seal does not match its content: {why}")
    try:
        _check_contents(body)
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            _check_entries(archive.zip, largest)
            arrays = {name: archive[name] for name in archive.files}
        header = _header(arrays.pop("header"))
    except SealError:
        raise
    # Intact seal, foreign content: whatever the parsers make of it, it is not one of our files.
    except Exception as error:
        raise SealError(f"it is sealed, but not a jaxmpc file: {error}") from None
    if not isinstance(header, dict):
        raise SealError("it is sealed, but its header is not a table")
    return header, arrays


def _check_contents(body: bytes) -> None:
    """Refuse a table of contents that would take far more memory than it has bytes; `seal` ends its file with it."""
    if len(body) < _END.size:
        return
    mark, *_, size, _, _ = _END.unpack(body[-_END.size :])
    if mark == b"PK\5\6" and size > LARGEST_CONTENTS:
        raise SealError(f"its table of contents has {size} bytes, more than {LARGEST_CONTENTS}")


def _check_entries(archive: zipfile.ZipFile, largest: int) -> None:
    """Refuse what `seal` never writes, before a byte of an array is unpacked: names, sizes, kinds of numbers."""
    entries = archive.infolist()
    if sum(entry.file_size for entry in entries) > largest:
        raise SealError(f"it unpacks to more than {largest} bytes")
    names = [entry.filename for entry in entries]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise SealError(f"it holds {twice!r} more than once")
    if "header.npy" not in names:
        raise SealError("it is sealed, but has no header")
    for entry in entries:
        if not _NAME.fullmatch(entry.filename):
            raise SealError(f"it holds {entry.filename!r}, which is no name of an array")
        if entry.compress_type != zipfile.ZIP_STORED:
            raise SealError(f"{entry.filename} is compressed, as no file of ours is")
        with archive.open(entry) as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(file)
            left = entry.file_size - file.tell()
        if dtype.kind not in _KINDS or dtype.itemsize == 0:
            raise SealError(f"{entry.filename} is an array of {dtype}, not of numbers or words")
        size = math.prod(shape) * dtype.itemsize
        if size > LARGEST or max(shape, default=0) > LARGEST:
            raise SealError(f"an array in it claims to have more than {LARGEST} bytes")
        if size != left:
            raise SealError(f"{entry.filename} claims {size} bytes and has {left}")


def _header(text: np.ndarray) -> Any:
    """The header's table; a key that stands twice in it, or a number that is none, is refused."""
    if text.dtype != np.uint8 or text.ndim != 1:
        raise SealError("its header is no text")
    header = json.loads(text.tobytes().decode(), object_pairs_hook=_once, parse_constant=_refused)
    _check_depth(header)
    return header


def _check_depth(header: Any) -> None:
    """Refuse what whoever reads a header part by part could not go down into."""
    level = [header]
    for _ in range(DEEPEST):
        tables = [each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)]
        level = [each for table in tables for each in table]
        if not level:
            return
    raise SealError(f"its header is nested more than {DEEPEST} deep")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        keys = [key for key, _ in pairs]
        raise SealError(f"its header has the key {next(key for key in keys if keys.count(key) > 1)!r} twice")
    return table


def _refused(word: str) -> Any:
    raise SealError(f"its header holds {word}, which is no number of JSON")


def write_atomic(path: Path, data: bytes | Iterable[bytes]) -> None:
    """Write a file so that after a crash at any moment it is there whole, or as it was before.

    Args:
        path: Of the file.
        data: What it is to hold; of what is large its pieces in order, so that they need not be there at once.

    Raises:
        OSError: The disk is full or the folder not writable, with the file's name; no partial file stays behind.
    """
    try:
        _write_atomic(path, data)
    except OSError as error:
        error.filename = f"{path}"
        raise


def write_first(path: Path, data: bytes) -> bool:
    """Write a file that only one process may begin: whole, and never in the place of one that is there.

    Args:
        path: Of the file.
        data: What it is to hold.

    Returns:
        Whether it was written; False where another is there, which may be another process's of this moment.

    Raises:
        OSError: See `write_atomic`.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:50]}.")
    os.close(handle)
    try:
        write_atomic(Path(name), data)
        try:
            os.link(name, path)
        except FileExistsError:
            return False
        except OSError:
            # A file system without links: as safe as a look beforehand is.
            write_atomic(path, data)
    finally:
        os.unlink(name)
    return True


def _write_atomic(path: Path, data: bytes | Iterable[bytes]) -> None:
    # Of a name as long as can be a part, since the file's own must not become too long.
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:50]}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines([data] if isinstance(data, bytes) else data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
