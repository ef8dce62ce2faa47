"""Motion of the heart's surface: a harmonic template, or the user's own recording."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxmpc.errors import InputError

Motion = np.ndarray
"""Displacement over time, shape (steps, 3) [m]."""

HARMONICS_HZ = np.array([0.34, 0.72, 1.25, 2.53, 3.78, 5.08, 6.32])
"""The seven peaks of the paper's Fig. 4: two of respiration, five of the heartbeat [Hz]."""
AMPLITUDES_MM = np.array(
    [
        [0.80, 0.28, 1.50, 0.80, 0.46, 0.28, 0.16],
        [0.90, 0.30, 1.15, 0.60, 0.35, 0.20, 0.12],
        [1.90, 0.60, 2.85, 1.45, 0.80, 0.45, 0.26],
    ]
)
"""Zero-to-peak amplitudes of X, Y, Z; chosen with Table I in view, so matching it is a calibration [mm]."""
PHASES_DEG = np.array(
    [
        [0.0, 70.0, 265.0, 190.0, 130.0, 70.0, 20.0],
        [35.0, 110.0, 250.0, 150.0, 60.0, 330.0, 270.0],
        [15.0, 85.0, 270.0, 190.0, 110.0, 30.0, 310.0],
    ]
)
"""Phases of the cosines; no publication gives any, hence the option to draw them [deg]."""

COARSEST_RECORDING_HZ = 50.0
LARGEST_MOTION = 0.1
"""Peak to peak beyond which a recording is taken to be in another unit [m]."""


def harmonic_motion(t: np.ndarray, scale: float = 1.0, phase_seed: int | None = None) -> Motion:
    """x(t) = Σ A cos(2π f t + φ) per axis.

    Args:
        t: Times, shape (steps,) [s].
        scale: Factor on all amplitudes [-].
        phase_seed: Draws all phases uniformly; None keeps the table's.
    """
    phases = np.deg2rad(PHASES_DEG)
    if phase_seed is not None:
        phases = np.random.Generator(np.random.Philox(phase_seed)).uniform(0.0, 2.0 * np.pi, phases.shape)
    angle = 2.0 * np.pi * HARMONICS_HZ * t[:, None]
    motion: Motion = (
        1e-3
        * scale
        * np.stack(
            [np.cos(angle + phase) @ amplitude for phase, amplitude in zip(phases, AMPLITUDES_MM, strict=True)], axis=1
        )
    )
    return motion


def fade_in(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """0 before `start`, 1 after `start + duration` [s], with continuous velocity and acceleration between."""
    s = np.clip((t - start) / duration, 0.0, 1.0) if duration > 0.0 else (t >= start).astype(float)
    faded: np.ndarray = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return faded


def read_recording(path: str | Path, unit: str = "m") -> tuple[np.ndarray, Motion]:
    """A recording with columns t [s], x, y, z, from CSV (named in its first line) or npz (arrays t, x, y, z).

    Args:
        path: The file.
        unit: "m" or "mm", of x, y, z.

    Returns:
        Times from 0, shape (n,) [s], and displacements about their mean, shape (n, 3) [m].

    Raises:
        InputError: The file cannot be read, has other columns, holds something that is no finite
            number, jumps in time, has a gap, is sampled below 50 Hz, or spans more than a heart does.
    """
    path = Path(path)
    names, table = _read_table(path)
    if unit not in ("m", "mm"):
        raise InputError("motion.unit", unit, '"m" or "mm"', "Name the unit of the columns x, y, z.")
    if sorted(names) != ["t", "x", "y", "z"]:
        found = ", ".join(names) or "none"
        raise InputError("columns", found, "t, x, y, z", "Name the columns t [s], x, y, z.", path, 1)
    t, *axes = (table[names.index(name)] for name in ("t", "x", "y", "z"))
    values = np.stack(axes, axis=1) * {"m": 1.0, "mm": 1e-3}[unit]
    _check_recording(path, t, values)
    return t - t[0], values - values.mean(axis=0)


def _read_table(path: Path) -> tuple[list[str], np.ndarray]:
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return list(archive.files), np.stack([np.asarray(archive[name], float) for name in archive.files])
        with path.open(encoding="utf-8-sig") as file:
            names = [name.strip() for name in file.readline().split(",")]
            return names, _read_rows(path, file.readlines(), len(names)).T
    except InputError:
        raise
    except OSError as error:
        reason = error.strerror or "it is not an npz file"
        raise InputError("motion.file", str(path), "readable", f"{reason}.") from None
    except (ValueError, EOFError) as error:
        raise InputError("motion.file", str(path), "CSV or npz of numbers", f"{error}.") from None


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
        raise refuse(len(t), "rows", len(t), "at least 4", "Record more of the motion.")
    table = np.column_stack([t, values])
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        name = "txyz"[column]
        raise refuse(row, name, table[row, column], "finite", "Cut the recording there or repair the sample.")
    steps = np.diff(t)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise refuse(row, "t", f"{t[row]:g} s after {t[row - 1]:g} s", "increasing", "Sort the rows, drop duplicates.")
    usual = float(np.median(steps))
    if usual > 1.0 / COARSEST_RECORDING_HZ * (1.0 + 1e-6):
        raise refuse(0, "sampling", f"{1.0 / usual:.3g} Hz", "at least 50 Hz", "Record faster: splines add no detail.")
    if (steps > 1.5 * usual).any():
        row = int(np.argmax(steps > 1.5 * usual)) + 1
        gap = f"a gap of {steps[row - 1]:.4g} s before t = {t[row]:g} s"
        raise refuse(row, "t", gap, f"steps near {usual:.4g} s", "Cut the recording there or fill the gap.")
    spans = np.ptp(values, axis=0)
    if spans.max() > LARGEST_MOTION:
        axis = "xyz"[int(np.argmax(spans))]
        remedy = 'If the file is in millimetres, set motion.unit = "mm".'
        raise refuse(0, axis, f"{spans.max():.3g} m peak to peak", f"at most {LARGEST_MOTION} m", remedy)


def recorded_motion(t: np.ndarray, times: np.ndarray, values: Motion, repeat: bool, path: str | Path) -> Motion:
    """A recording resampled by a spline with continuous acceleration (a linear one makes force spikes).

    Args:
        t: Times wanted, shape (steps,) [s].
        times: Times of the recording, from 0 [s].
        values: Its displacements [m].
        repeat: Play it again and again, faded to rest over 0.5 s at both ends, 1 s of rest between.
        path: The file, for the message.

    Raises:
        InputError: It is shorter than the experiment and not repeated.
    """
    from scipy.interpolate import CubicSpline

    spline, length = CubicSpline(times, values), times[-1]
    if not repeat:
        if t[-1] > length + 1e-9:
            remedy = "Shorten the experiment's duration or set motion.repeat = true."
            raise InputError("motion.file", f"{path} with {length:g} s", f"at least {t[-1]:g} s long", remedy)
        return np.asarray(spline(np.minimum(t, length)))
    local = np.mod(t, length + 1.0)
    envelope = fade_in(local, 0.0, 0.5) * (1.0 - fade_in(local, length - 0.5, 0.5))
    return np.asarray(spline(np.minimum(local, length))) * envelope[:, None]
