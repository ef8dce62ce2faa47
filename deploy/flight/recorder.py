"""The flight recorder: the last seconds of every signal, in memory until something asks for them.

A recording is a sealed npz (`jaxmpc.files.sealed`) with one array per signal, (samples, width), under the names and in
the units of the simulator's own trace (`ArmSample`), and more that only a robot has. Its header says which
controller flew, why the recording was written, and both clocks: the monotonic one that stamps samples, and what
the wall clock showed at the same moment.
"""

import struct
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.files.foreign import read_bytes
from jaxmpc.files.sealed import LARGEST, SealError, seal, unseal, write_atomic

SCHEMA, VERSION = "jaxmpc flight recording", 1
SIMULATED: Mapping[str, tuple[int, str]] = {
    "time": (1, "s"),
    "force": (3, "N"),
    "force_ref": (3, "N"),
    "u": (3, "N"),
    "v": (3, "m/s²"),
    "a": (3, "m/s²"),
    "p_hat": (3, "m/s²"),
    "gain": (1, "-"),
    "stiffness": (3, "N/m"),
    "authority": (3, "-"),
    "dither": (3, "N"),
    "tip": (3, "m"),
    "q": (4, "rad"),
    "torque": (4, "N m"),
}
"""Signals that the simulator has too, with width and unit. `time` is that since the first cycle; `force` and `q`
are what the law was given (a force that it had to do without is NaN); `torque` is what the frame really carried.
`stiffness`, `authority` and `dither` are zero without a schedule, and older recordings lack them."""
ROBOT: Mapping[str, tuple[int, str]] = {
    "qd": (4, "rad/s"),
    "gain_memory": (2, "-"),
    "deflection": (4, "-"),
    "swing_share": (1, "-"),
    "wanted": (4, "N m"),
    "applied": (4, "N m"),
    "state": (1, ""),
    "reason": (1, ""),
    "clamped": (1, ""),
    "counts": (4, "counts"),
    "position_age": (4, "cycles"),
    "force_age": (1, "cycles"),
    "lateness": (1, "s"),
    "compute": (1, "s"),
}
"""Signals that only a robot has: `gain_memory` is the ceiling of `gain` and where it was lately; `deflection` that of
the bristles of the friction that is cancelled and `swing_share` what a guard takes for a lasting swing, zero without,
which older recordings lack; `wanted` is the law's torque, `applied` what the clamps left of it and the observers were
told; `position_age` is that of each motor's last believed position; `state`, `reason` and `clamped` are the numbers
that the header's `names` spell out."""
COLUMNS = {**SIMULATED, **ROBOT}
ROOM = 2**16
"""For a file's header and table of contents [bytes]; they take some 10 000."""


class RecordingError(ValueError):
    """A file is not a flight recording; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class FlightRecording:
    """What a file holds.

    Attributes:
        header: Plain data: `artifact` (sha256), `reason`, `T_s` [s], `columns` and whatever else was given.
        signals: Arrays (samples, width) by name, oldest sample first.
    """

    header: dict[str, Any]
    signals: dict[str, np.ndarray]


class FlightRecorder:
    """A ring of rows of numbers, allocated once."""

    def __init__(
        self, columns: Mapping[str, tuple[int, str]] = COLUMNS, seconds: float = 10.0, rate: float = 1000.0
    ) -> None:
        """Allocate.

        Args:
            columns: Width and unit of each signal, in the order of a row.
            seconds: Length of the ring [s].
            rate: Rows per second [1/s].
        """
        self.columns = dict(columns)
        self.width = sum(width for width, _ in self.columns.values())
        self.length = max(1, round(seconds * rate))
        self.refused = 0
        """Rows that were not numbers, or of another length."""
        row = struct.Struct(f"{self.width}d")
        if row.size * self.length > LARGEST // 2:
            raise ValueError(f"a recording of {row.size * self.length} bytes could not be read again")
        self._pack, self._stride, self._size = row.pack_into, row.size, row.size * self.length
        # NaN throughout. Touched now: a page first written within a cycle would have to be fetched within it.
        self._memory = bytearray(b"\xff" * self._size)
        self._offset = self._written = 0

    def __len__(self) -> int:
        return min(self._written, self.length)

    def append(self, row: Sequence[float]) -> None:
        """Keep a row, all signals one after the other; the oldest is overwritten. It never raises."""
        try:
            self._pack(self._memory, self._offset, *row)
        except struct.error:
            self.refused += 1
            self._memory[self._offset : self._offset + self._stride] = b"\xff" * self._stride  # all NaN
            return
        self._written += 1
        self._offset += self._stride
        if self._offset == self._size:
            self._offset = 0

    def signals(self) -> dict[str, np.ndarray]:
        """A copy of everything that is in the ring, oldest row first."""
        table = np.frombuffer(self._memory).reshape(self.length, self.width)
        first = self._written % self.length if self._written > self.length else 0
        rows = np.concatenate([table[first : min(self._written, self.length)], table[:first]])
        ends = np.cumsum([width for width, _ in self.columns.values()])[:-1]
        return dict(zip(self.columns, np.split(rows, ends, axis=1), strict=True))

    @staticmethod
    def largest(seconds: float, rate: float) -> int:
        """Most bytes that a file of the usual columns can have, some for its header included.

        Args:
            seconds: Length of the ring [s].
            rate: Rows per second [1/s].
        """
        width = sum(width for width, _ in COLUMNS.values())
        return 8 * width * max(1, round(seconds * rate)) + ROOM

    def sealed(self, header: Mapping[str, Any]) -> bytes:
        """A file's content, made in some tens of milliseconds: torques must be off by then.

        Args:
            header: Plain data: `artifact`, `reason`, `T_s` and whatever else is worth knowing.

        Raises:
            TypeError: The header is no plain data.
            ValueError: It holds an infinity.
        """
        clocks = {"monotonic_ns": time.monotonic_ns(), "wall_ns": time.time_ns()}
        columns = {name: list(column) for name, column in self.columns.items()}
        about = {"schema": SCHEMA, "version": VERSION, "columns": columns, "refused": self.refused, **clocks}
        return seal({**header, **about}, self.signals())

    def write(self, path: Path, header: Mapping[str, Any]) -> str:
        """Write a recording, in some tens of milliseconds: torques must be off by then.

        Args:
            path: Where to.
            header: Plain data: `artifact`, `reason`, `T_s` and whatever else is worth knowing.

        Returns:
            A sentence: what was written, or why nothing was. Then the rows are still in memory.
        """
        try:
            count = len(self)
            write_atomic(path, self.sealed(header))
        except OSError as error:
            return (
                f"the flight recording could not be written to {path}: {error.strerror or error}; it is kept in memory"
            )
        except (TypeError, ValueError) as error:
            return f"the flight recording could not be sealed: {error}; it is kept in memory"
        return f"flight recording: {count} samples in {path}"


def read(path: Path | str) -> FlightRecording:
    """A recording from a file.

    Raises:
        InputError: It cannot be read.
        RecordingError: It was changed, or is no recording.
    """
    try:
        header, signals = unseal(read_bytes(path, LARGEST, "recording"))
    except SealError as error:
        raise RecordingError(f"{path}: {error}") from None
    if header.get("schema") != SCHEMA:
        raise RecordingError(f"{path}: it is sealed, but no flight recording: its schema is {header.get('schema')!r}")
    version = header.get("version")
    if version != VERSION:
        raise RecordingError(f"{path}: it has version {version!r} of the format; this jaxmpc reads {VERSION}")
    columns = header.get("columns")
    if not isinstance(columns, dict) or set(columns) != set(signals):
        raise RecordingError(f"{path}: its arrays are not the columns that its header lists")
    lengths = {array.shape[0] if array.ndim == 2 else -1 for array in signals.values()}
    if any(array.dtype != np.float64 for array in signals.values()) or len(lengths) > 1 or lengths == {-1}:
        raise RecordingError(f"{path}: its arrays are not tables of float64 of the same length")
    for name, (width, _) in COLUMNS.items():
        if name in signals and signals[name].shape[1] != width:
            raise RecordingError(f"{path}: {name} has {signals[name].shape[1]} columns, not {width}")
    return FlightRecording(header, signals)
