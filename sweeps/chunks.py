"""Chunks of a sweep, sealed; those that are there and intact need not be computed again.

A chunk is named by the rows that it holds, so the chunk size may differ from run to run. Work that is done twice does
no harm: whoever does it writes the same rows, and every write is atomic.
"""

import logging
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc.files.errors import InputError, UnreadableError
from jaxmpc.files.foreign import read_bytes
from jaxmpc.files.sealed import LARGEST, SealError, seal, unseal, write_atomic
from sweeps.plan import SCHEMA, Columns, Plan

DAMAGED = ".damaged"
log = logging.getLogger(__name__)


class StoredChunks(NamedTuple):
    """What a folder holds."""

    columns: Columns
    """Every column of the plan's layout; rows that are not there hold zeros."""
    there: np.ndarray
    """Whether each planned row is there."""

    def add(self, first: int, last: int, columns: Mapping[str, np.ndarray]) -> None:
        """Take planned rows first … last − 1 in."""
        for name, values in self.columns.items():
            values[first:last] = columns[name]
        self.there[first:last] = True


def read_chunks(folder: Path, plan: Plan, *, known: StoredChunks | None = None, mend: bool = False) -> StoredChunks:
    """Every intact row of this sweep; a damaged chunk is reported and counts as absent.

    Args:
        folder: The sweep's.
        plan: What is swept.
        known: What is known already; only chunks with other rows are read, and added to it.
        mend: Whether to put damaged chunks out of the way, to be computed again.

    Raises:
        UnreadableError: Of `mend` alone: the system does not let a chunk be read, which may be whole all the same.
    """
    found = _nothing(plan) if known is None else known
    for path in chunk_files(folder):
        if (stretch := stretch_of(path.name)) and found.there[slice(*stretch)].all():
            continue
        try:
            first, last, arrays = _read_chunk(path, plan)
        except UnreadableError as error:
            if mend:
                remedy = f"{error.remedy} It may be whole: mend that, or move it away to have its rows computed again."
                raise UnreadableError(error.key, error.value, error.bound, remedy) from None
            log.warning("%s is left out: %s", path.name, error.remedy)
            continue
        except SealError as error:
            if not os.path.lexists(path):
                continue  # another process was faster
            fate = "is computed again" if mend else "is left out, until the sweep is run again"
            log.warning("%s %s: %s", path.name, fate, error)
            if mend:
                with suppress(FileNotFoundError):  # the same
                    os.replace(path, path.with_name(path.name + DAMAGED))
            continue
        found.add(first, last, arrays)
    return found


def _nothing(plan: Plan) -> StoredChunks:
    rows = len(plan.rows)
    columns = {name: np.zeros((rows, *column.shape), column.dtype) for name, column in plan.layout.items()}
    return StoredChunks(columns, np.zeros(rows, bool))


def chunk_files(folder: Path) -> list[Path]:
    """The chunks of a folder, by the rows that they hold."""
    return sorted((folder / "chunks").glob("[0-9]*.npz"))


def chunk_name(first: int, last: int) -> str:
    """Name of a chunk, of its lease, and of what is set aside."""
    return f"{first:09d}-{last:09d}"


def stretch_of(name: str) -> tuple[int, int] | None:
    """First row and the one behind the last, of a name; None if it is none of ours."""
    first, _, last = name.partition(".")[0].partition("-")
    return (int(first), int(last)) if first.isdigit() and last.isdigit() else None


def write_chunk(folder: Path, plan: Plan, first: int, last: int, columns: Mapping[str, np.ndarray]) -> None:
    """Write planned rows first … last − 1, whole or not at all.

    Raises:
        OSError: The disk is full or the folder not writable.
    """
    header = {"schema": SCHEMA, "spec_hash": plan.spec_hash, "first": first, "last": last}
    path = folder / "chunks" / f"{chunk_name(first, last)}.npz"
    # Who slept while another did its work has the same bits, and nothing to add.
    if not path.exists():
        write_atomic(path, seal(header, columns))
    path.with_name(path.name + DAMAGED).unlink(missing_ok=True)


def _read_chunk(path: Path, plan: Plan) -> tuple[int, int, Columns]:
    try:
        header, arrays = unseal(read_bytes(path, LARGEST))
    except UnreadableError:
        raise
    except InputError as error:
        raise SealError(f"{error}") from None
    if header.get("spec_hash") != plan.spec_hash or header.get("schema") != SCHEMA:
        raise SealError("it belongs to another sweep")
    first, last = header.get("first"), header.get("last")
    if type(first) is not int or type(last) is not int or not 0 <= first < last <= len(plan.rows):
        raise SealError("it does not say which rows it holds")
    if stretch_of(path.name) not in (None, (first, last)):
        # In the place of those that it is named by, which are never written while it is there.
        raise SealError(f"it holds rows {first} … {last - 1}, others than its name says")
    shapes = {name: (column.dtype, (last - first, *column.shape)) for name, column in plan.layout.items()}
    if {name: (values.dtype.str, values.shape) for name, values in arrays.items()} != shapes:
        raise SealError("its columns are not those of this sweep")
    if not np.array_equal(arrays["row"], plan.rows[first:last]):
        raise SealError("its rows are not those of this sweep")
    return first, last, arrays
