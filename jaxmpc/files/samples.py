"""Recordings of samples as somebody else's program wrote them: npz of vectors, or the lines of a CSV file."""

import io
from pathlib import Path

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import LARGEST_RECORDING, read_bytes, read_text


def npz_vectors(path: Path, key: str) -> dict[str, np.ndarray]:
    """The arrays of an npz file, all vectors of one length, as float64.

    Args:
        path: Of the file.
        key: What named it, for messages.

    Raises:
        InputError: It cannot be read, is damaged, would unpack to too much, or holds something else.
    """
    data = io.BytesIO(read_bytes(path, LARGEST_RECORDING, key))
    try:
        with np.load(data, allow_pickle=False) as archive:
            if sum(entry.file_size for entry in archive.zip.infolist()) > LARGEST_RECORDING:
                raise ValueError(f"It unpacks to more than {LARGEST_RECORDING} bytes")
            columns = {name: np.atleast_1d(np.asarray(archive[name], float)) for name in archive.files}
        lengths = {column.shape for column in columns.values()}
        if len(lengths) > 1 or any(len(shape) != 1 for shape in lengths):
            raise ValueError("The arrays are not all vectors of one length")
        return columns
    # A damaged archive fails in the zip reader, in numpy's of a header, or claims more than there is memory.
    except Exception as error:
        raise InputError(key, path, "CSV or npz of numbers", f"{error}.") from None


def csv_lines(path: Path, key: str) -> tuple[list[str], list[str]]:
    """Names in the first line of a CSV file, and the lines below it.

    Raises:
        InputError: The file cannot be read.
    """
    head, *lines = read_text(path, LARGEST_RECORDING, key).removesuffix("\n").split("\n")
    return [name.strip() for name in head.split(",")], lines
