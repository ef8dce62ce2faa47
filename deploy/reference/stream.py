"""Wanted force over time, as a stream that nothing can make jump.

A source says which force is wanted at a time; `Stream` follows it, limited in magnitude and in rate. With preview
it hands out the next H samples: what a source without a future asks for then acts H samples later.
"""

import math
import os
from collections import deque
from pathlib import Path

from deploy.reference.sources import Constant, Lines, Source, Table
from jaxmpc.files.errors import InputError
from jaxmpc.law.vectors import Vector3

__all__ = ["Constant", "Lines", "Source", "Stream", "Table", "csv_file", "from_text", "ramps"]

RATE, LARGEST = 5.0, 10.0
"""Largest rate [N/s] and magnitude [N] of a wanted force, unless the caller gives others."""
_CATCH_UP = 3
"""Samples that the force goes on at once after missed ones; more of them would be a jump."""
_LARGEST_FILE = 16 * 2**20


class Stream:
    """What the controller is given: a source, limited, sample by sample."""

    def __init__(
        self,
        source: Source,
        T_s: float,
        start: Vector3 = (0.0, 0.0, 0.0),
        *,
        rate: float = RATE,
        largest: float = LARGEST,
        ahead: int = 0,
    ) -> None:
        """Begin at a force.

        Args:
            source: What is wanted.
            T_s: Sampling time [s].
            start: Force at contact, from which the first sample goes on [N].
            rate: Largest change of the vector per time [N/s].
            largest: Largest magnitude [N].
            ahead: Samples of preview H; 0 for none.

        Raises:
            InputError: A limit is not positive and finite.
        """
        for key, value in (("rate", rate), ("largest", largest), ("T_s", T_s)):
            if not 0.0 < value < math.inf:
                raise InputError(key, value, "positive and finite", "It is what keeps the wanted force from jumping.")
        self._source, self._T_s, self._step, self._largest = source, T_s, rate * T_s, largest
        self._ahead = ahead
        self._force = start if math.isfinite(sum(start)) else (0.0, 0.0, 0.0)
        self._sample = 0
        self._axes = tuple(deque([value] * max(ahead, 1), maxlen=max(ahead, 1)) for value in self._force)
        for _ in range(ahead - 1):
            self._advance()

    def at(self, t: float) -> Vector3 | tuple[tuple[float, ...], ...]:
        """Wanted force of the sample at a time since contact [s].

        Times do not go back. After missed samples it follows the source on, never faster than three samples at once.

        Returns:
            Force [N], 3 floats; with preview 3 × H, of the next H samples.
        """
        steps = round(t / self._T_s) + self._ahead - self._sample
        if steps > _CATCH_UP:
            self._sample += steps - _CATCH_UP
            steps = _CATCH_UP
        for _ in range(steps):
            self._advance()
        x, y, z = self._axes
        return (tuple(x), tuple(y), tuple(z)) if self._ahead else self._force

    def notes(self) -> list[str]:
        """What the source has to say."""
        return self._source.notes()

    def _advance(self) -> None:
        self._sample += 1
        x, y, z = self._source.wanted(self._sample * self._T_s)
        size = math.hypot(x, y, z)
        if not math.isfinite(size):
            x, y, z = self._force
        elif size > self._largest:
            share = self._largest / size
            x, y, z = share * x, share * y, share * z
        was_x, was_y, was_z = self._force
        dx, dy, dz = x - was_x, y - was_y, z - was_z
        change = math.hypot(dx, dy, dz)
        if change > self._step:
            share = self._step / change
            x, y, z = was_x + share * dx, was_y + share * dy, was_z + share * dz
        self._force = (x, y, z)
        for axis, value in zip(self._axes, self._force, strict=True):
            axis.append(value)


def from_text(text: str, *, rate: float = RATE, largest: float = LARGEST, start: Vector3 = (0.0, 0.0, 0.0)) -> Source:
    """The source that an argument of the command line means.

    Args:
        text: `0,0,-5` is constant [N]; `ramps:0,0,-5@2 hold@5 0,0,2@1` goes to forces [N] at rates [N/s] and waits
            [s]; `-` is standard input, line by line; anything else is a CSV file with the columns t,x,y,z.
        rate: Largest rate of ramps and files [N/s].
        largest: Largest magnitude [N].
        start: Force at contact, where ramps begin [N].

    Raises:
        InputError: It is none of these, or asks for more than the limits.
    """
    if text == "-":
        return Lines(0, start, largest)
    if text.startswith("ramps:"):
        return ramps(text.removeprefix("ramps:"), rate=rate, largest=largest, start=start)
    if os.path.exists(text):
        return csv_file(Path(text), rate=rate, largest=largest)
    force = _force(text)
    if force is None:
        bound = "X,Y,Z [N], ramps:…, - for standard input, or an existing file"
        raise InputError("reference", text, bound, "For example 0,0,-5, or a CSV file with the columns t,x,y,z.")
    _check_size(force, largest, "reference")
    return Constant(force)


def ramps(text: str, *, rate: float, largest: float, start: Vector3 = (0.0, 0.0, 0.0)) -> Table:
    """Segments in a row: `X,Y,Z@RATE` goes to a force [N] at a rate [N/s], `hold@SECONDS` waits.

    Raises:
        InputError: A segment is none of these, or exceeds a limit.
    """
    times, forces = [0.0], [start]
    for word in text.split():
        target, _, number = word.partition("@")
        value = _number(number)
        if not 0.0 < value <= 1e4:
            bound = "X,Y,Z@RATE or hold@SECONDS with a number in (0, 10000]"
            raise InputError("reference", word, bound, "For example 0,0,-5@2 hold@5.")
        if target == "hold":
            times.append(times[-1] + value)
            forces.append(forces[-1])
            continue
        force = _force(target)
        if force is None:
            raise InputError("reference", word, "X,Y,Z@RATE or hold@SECONDS", "For example 0,0,-5@2 hold@5.")
        _check_size(force, largest, "reference")
        if value > rate:
            raise InputError("reference", word, f"at most {rate:g} N/s fast", "Ask for a slower ramp.")
        distance = math.dist(force, forces[-1])
        if distance > 0.0:
            times.append(times[-1] + distance / value)
            forces.append(force)
    return Table(times, forces)


def csv_file(path: Path, *, rate: float, largest: float) -> Table:
    """Rows `t,x,y,z` [s], [N] below a line that names these columns.

    Raises:
        InputError: It cannot be read, a line is malformed, time does not increase, or a force is too great or too
            fast; it names the line.
    """
    times: list[float] = []
    forces: list[Vector3] = []
    for line, text in enumerate(_text_of(path).splitlines(), start=1):
        cells = [cell.strip() for cell in text.split(",")]
        if line == 1:
            if cells != ["t", "x", "y", "z"]:
                remedy = "Time in s, wanted force on the tissue in N."
                raise InputError("the first line", text[:60], "t,x,y,z", remedy).at(path, 1)
            continue
        if not text.strip():
            continue
        values = [_number(cell) for cell in cells]
        if len(values) != 4 or not math.isfinite(sum(values)):
            raise InputError("row", text[:60], "four finite numbers", "Correct or remove it.").at(path, line)
        t, *force = values
        x, y, z = force
        if times and not t > times[-1]:
            raise InputError("t", t, f"above {times[-1]:g} s", "Give the rows in the order of time.").at(path, line)
        try:
            _check_size((x, y, z), largest, "force")
        except InputError as error:
            raise error.at(path, line) from None
        if times and math.dist((x, y, z), forces[-1]) > rate * (t - times[-1]) * (1.0 + 1e-9):
            speed = math.dist((x, y, z), forces[-1]) / (t - times[-1])
            bound = f"at most {rate:g} N/s"
            raise InputError("rate", f"{speed:.4g} N/s", bound, "Give the change more time.").at(path, line)
        times.append(t)
        forces.append((x, y, z))
    if not times:
        raise InputError("rows", 0, "at least one", "A single row is a constant force.").at(path)
    return Table(times, forces, path.name)


def _text_of(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
        if len(data) > _LARGEST_FILE:
            raise InputError("size", "more bytes", f"at most {_LARGEST_FILE}", "Thin the rows out.").at(path)
        return data.decode("utf-8-sig")
    except OSError as error:
        raise InputError("reference", path, "a readable file", f"It cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise InputError("encoding", "not UTF-8", "UTF-8", "Save it as plain text.").at(path) from None


def _check_size(force: Vector3, largest: float, key: str) -> None:
    size = math.hypot(*force)
    if not size <= largest:
        raise InputError(key, f"{size:.4g} N", f"at most {largest:g} N", "Ask for less, or declare a higher limit.")


def _force(text: str) -> Vector3 | None:
    values = [_number(word) for word in text.split(",")]
    return (values[0], values[1], values[2]) if len(values) == 3 and math.isfinite(sum(values)) else None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
