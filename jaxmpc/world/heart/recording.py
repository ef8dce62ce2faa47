"""The user's own recording of heart motion: read with suspicion, played with continuous acceleration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.samples import csv_lines, npz_vectors
from jaxmpc.world.heart.harmonics import fade_in, fade_in_rate

COLUMNS = ("t", "x", "y", "z")
COARSEST_RECORDING_HZ = 50.0
LARGEST_MOTION = 0.1
"""Peak to peak beyond which a recording is taken to be in another unit [m]."""
SMALLEST_MOTION = 1e-4
"""What moves less is no heart, but one in another unit [m]."""
REST, FADE = 1.0, 0.5
"""Between repetitions: rest, and time in which the motion fades at both ends [s]."""


def read_recording(path: str | Path, unit: str = "m") -> tuple[np.ndarray, np.ndarray]:
    """A recording with columns t [s], x, y, z, from CSV (named in its first line) or npz (arrays t, x, y, z).

    Args:
        path: The file.
        unit: "m" or "mm", of x, y, z.

    Returns:
        Times from 0, shape (n,) [s], and displacements about their mean, shape (n, 3) [m].

    Raises:
        InputError: The file cannot be read, has other columns, holds something that is no finite
            number, jumps in time, has a gap, is sampled below 50 Hz, or spans more than a heart does.
            It names the line of a CSV, the header being line 1.
    """
    path = Path(path)
    if unit not in ("m", "mm"):
        raise InputError("motion.unit", unit, '"m" or "mm"', "Name the unit of the columns x, y, z.")
    names, table = _read_table(path)
    if sorted(names) != sorted(COLUMNS):
        found, line = ", ".join(names) or "none", None if path.suffix == ".npz" else 1
        raise InputError(
            "columns",
            found,
            ", ".join(COLUMNS),
            "Name them in the first line, without units; t is in seconds.",
            path,
            line,
        )
    t, *axes = (table[names.index(name)] for name in COLUMNS)
    values = np.stack(axes, axis=1) * {"m": 1.0, "mm": 1e-3}[unit]
    _check_recording(path, t, values)
    return t - t[0], values - values.mean(axis=0)


def recorded_motion(
    t: np.ndarray, times: np.ndarray, values: np.ndarray, repeat: bool, path: str | Path
) -> tuple[np.ndarray, np.ndarray]:
    """A recording resampled by a spline with continuous acceleration (a linear one makes force spikes).

    Args:
        t: Times wanted, not decreasing, shape (n,) [s].
        times: Times of the recording, from 0, shape (samples,) [s].
        values: Its displacements, shape (samples, 3) [m].
        repeat: Play it again and again, faded to rest over 0.5 s at both ends, 1 s of rest between.
        path: The file, for the message.

    Returns:
        Position, shape (n, 3) [m], and velocity, shape (n, 3) [m/s].

    Raises:
        InputError: It is shorter than the experiment and not repeated.
    """
    from scipy.interpolate import CubicSpline

    spline, length = CubicSpline(times, values), float(times[-1])
    if not repeat:
        if t.max(initial=0.0) > length + 1e-9:
            remedy = "Shorten the experiment's duration or set motion.repeat = true."
            raise InputError("motion.file", f"{path} with {length:g} s", f"at least {t[-1]:g} s long", remedy)
        return np.asarray(spline(t)), np.asarray(spline(t, 1))
    local = np.mod(t, length + REST)
    # In the rest the envelope is 0, whatever the spline holds there.
    inside = np.minimum(local, length)
    position, velocity = np.asarray(spline(inside)), np.asarray(spline(inside, 1))
    rise, fall = fade_in(local, 0.0, FADE), 1.0 - fade_in(local, length - FADE, FADE)
    slope = fade_in_rate(local, 0.0, FADE) * fall - rise * fade_in_rate(local, length - FADE, FADE)
    envelope = (rise * fall)[:, None]
    return envelope * position, envelope * velocity + slope[:, None] * position


def _read_table(path: Path) -> tuple[list[str], np.ndarray]:
    if path.suffix == ".npz":
        columns = npz_vectors(path, "motion.file")
        return list(columns), np.array(list(columns.values()))
    names, lines = csv_lines(path, "motion.file")
    return names, _read_rows(path, lines, len(names)).T


def _read_rows(path: Path, lines: Sequence[str], columns: int) -> np.ndarray:
    rows = []
    for number, line in enumerate(lines, 2):
        cells = line.strip().split(",")
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise InputError("row", line.strip(), "numbers", "Correct or remove this row.", path, number) from None
        if len(cells) != columns:
            raise InputError("row", line.strip(), f"{columns} numbers", "Correct this row.", path, number)
    return np.array(rows).reshape(-1, columns)


def _check_recording(path: Path, t: np.ndarray, values: np.ndarray) -> None:
    def refuse(row: int, key: str, value: object, bound: str, remedy: str) -> InputError:
        return InputError(key, value, bound, remedy, path, row + 2 if path.suffix != ".npz" else None)

    if len(t) < 4:
        raise refuse(len(t) - 1, "rows", len(t), "at least 4", "Record more of the motion.")
    table = np.column_stack([t, values])
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        remedy = "Cut the recording there or repair the sample."
        raise refuse(int(row), COLUMNS[column], table[row, column], "finite", remedy)
    # The difference of two huge numbers may overflow to infinity; it is refused like any other.
    with np.errstate(over="ignore"):
        steps, spans = np.diff(t), np.ptp(values, axis=0)
        usual = float(np.median(steps))
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise refuse(row, "t", f"{t[row]:g} s after {t[row - 1]:g} s", "increasing", "Sort the rows, drop duplicates.")
    if usual > 1.0 / COARSEST_RECORDING_HZ * (1.0 + 1e-6):
        remedy = "Record faster: splines add no detail."
        if usual > 1.0:
            remedy += " If t is in milliseconds, convert it to seconds."
        raise refuse(1, "sampling", f"{1.0 / usual:.3g} Hz", "at least 50 Hz", remedy)
    if (steps > 1.5 * usual).any():
        row = int(np.argmax(steps > 1.5 * usual)) + 1
        gap = f"a gap of {steps[row - 1]:.4g} s before t = {t[row]:g} s"
        raise refuse(row, "t", gap, f"steps near {usual:.4g} s", "Cut the recording there or fill the gap.")
    if 0.0 < spans.max() < SMALLEST_MOTION:
        remedy = 'If the file is in metres, set motion.unit = "m".'
        moved = f"{1e3 * spans.max():.3g} mm peak to peak"
        raise refuse(0, "motion", moved, f"at least {1e3 * SMALLEST_MOTION:g} mm on an axis, or none", remedy)
    if spans.max() > LARGEST_MOTION:
        axis = int(np.argmax(spans))
        row = int(np.argmax(np.abs(values[:, axis])))
        remedy = 'If the file is in millimetres, set motion.unit = "mm".'
        raise refuse(row, "xyz"[axis], f"{spans[axis]:.3g} m peak to peak", f"at most {LARGEST_MOTION} m", remedy)
