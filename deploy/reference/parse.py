"""What the command line says of the wanted force: numbers, segments, an experiment, a file of rows, or a stream."""

import math
import os
from pathlib import Path

from deploy.reference.segments import Segments, check_size, from_table, from_words
from deploy.reference.sources import ConstantForce, ForceTable, Lines, Source
from deploy.reference.stream import LARGEST, RATE
from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import read_text, toml_of
from jaxmpc.law.vectors import Vector3

_LARGEST_FILE = 16 * 2**20


def from_text(text: str, *, rate: float = RATE, largest: float = LARGEST, start: Vector3 = (0.0, 0.0, 0.0)) -> Source:
    """The source that an argument of the command line means.

    Args:
        text: `0,0,-5` is constant [N]; `ramps:0,0,-5@2 hold@5 0,0,2@1` goes to forces [N] at rates [N/s] and waits
            [s]; `FILE.toml` is an experiment, of which the table [reference] is flown; `-` is standard input, line by
            line; anything else is a CSV file with the columns t,x,y,z.
        rate: Largest rate of segments and files [N/s].
        largest: Largest magnitude [N].
        start: Force at contact, where the words of `ramps:` begin [N].

    Raises:
        InputError: It is none of these, or asks for more than the limits.
    """
    if text == "-":
        return Lines(0, start, largest)
    if text.startswith("ramps:"):
        return from_words(text.removeprefix("ramps:"), rate=rate, largest=largest, start=start)
    if os.path.exists(text):
        reader = toml_file if text.endswith(".toml") else csv_file
        return reader(Path(text), rate=rate, largest=largest)
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        bound = "X,Y,Z [N], ramps:…, - for standard input, or an existing file"
        raise InputError("reference", text, bound, "For example 0,0,-5, or a CSV file with the columns t,x,y,z.")
    check_size((x, y, z), largest, "reference")
    return ConstantForce((x, y, z))


def toml_file(path: Path, *, rate: float, largest: float) -> Segments:
    """The table [reference] of an experiment's file.

    Raises:
        InputError: It cannot be read, has no such table, or asks for more than the limits.
    """
    data = toml_of(read_text(path), path)
    if not isinstance(table := data.get("reference"), dict):
        raise InputError("reference", "missing", "a table [reference]", "For example z = -5.0 in it.").at(path)
    try:
        return from_table(table, rate=rate, largest=largest, name=path.name)
    except InputError as error:
        raise error.at(path) from None


def csv_file(path: Path, *, rate: float, largest: float) -> ForceTable:
    """Rows `t,x,y,z` [s], [N] below a line that names these columns.

    Raises:
        InputError: It cannot be read, a line is malformed, time does not increase, or a force is too great or too
            fast; it names the line.
    """
    times: list[float] = []
    forces: list[Vector3] = []
    for line, text in enumerate(read_text(path, _LARGEST_FILE, "reference").splitlines(), start=1):
        cells = [cell.strip() for cell in text.split(",")]
        if line == 1:
            if cells != ["t", "x", "y", "z"]:
                remedy = "Time in s, wanted force on the tissue in N."
                raise InputError("the first line", text[:60], "t,x,y,z", remedy).at(path, 1)
            continue
        if not text.strip():
            continue
        values = list(map(_number, cells))
        if len(values) != 4 or not math.isfinite(sum(values)):
            raise InputError("row", text[:60], "four finite numbers", "Correct or remove it.").at(path, line)
        t, *force = values
        x, y, z = force
        if times and not t > times[-1]:
            raise InputError("t", t, f"above {times[-1]:g} s", "Give the rows in the order of time.").at(path, line)
        try:
            check_size((x, y, z), largest, "force")
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
    return ForceTable(times, forces, path.name)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
