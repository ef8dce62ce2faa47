"""Files that cannot change unnoticed: npz without pickle, closed by a sha256 over every byte before it."""

import hashlib
import io
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

SEAL = hashlib.sha256().digest_size
"""Length of the trailer [bytes]."""
LARGEST = 64 * 2**20
"""Largest file that is read [bytes]."""


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
    body = buffer.getvalue()
    return body + hashlib.sha256(body).digest()


def unseal(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of sealed bytes; nothing is parsed before the seal is found intact.

    Raises:
        SealError: The bytes are too few or too many, were changed or cut short, or hold something else.
    """
    if len(data) <= SEAL:
        raise SealError(f"it has {len(data)} bytes, fewer than its seal alone: it was cut short")
    if len(data) > LARGEST:
        raise SealError(f"it has {len(data)} bytes, more than the {LARGEST} that are read")
    body, trailer = data[:-SEAL], data[-SEAL:]
    if hashlib.sha256(body).digest() != trailer:
        raise SealError("its sha256 seal does not match its content: it was changed or cut short after it was written")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            if sum(entry.file_size for entry in archive.zip.infolist()) > LARGEST:
                raise SealError(f"it unpacks to more than {LARGEST} bytes")
            arrays = {name: archive[name] for name in archive.files}
        header = json.loads(arrays.pop("header").tobytes().decode())
    except SealError:
        raise
    # Intact seal, foreign content: whatever the parsers make of it, it is not one of our files.
    except Exception as error:
        raise SealError(f"it is sealed, but not a jaxmpc file: {error}") from None
    if not isinstance(header, dict):
        raise SealError("it is sealed, but its header is not a table")
    return header, arrays


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file so that after a crash at any moment it is there whole, or as it was before.

    Raises:
        OSError: The disk is full or the folder not writable; no partial file stays behind.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
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
