"""A flight as a report: what flew over what was computed anew, and how far they part."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import AXES
from jaxmpc.report.content import Chart, Report, Section, Series, Table
from jaxmpc.report.page import write_report
from jaxmpc.report.thinning import thinned

if TYPE_CHECKING:
    from deploy.flight.recorder import FlightRecording
    from deploy.flight.replay import Difference

JOINTS = ("J1", "J2", "J3", "J4")
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Force": ("force", "true_force"),
    "Controller": ("u", "v", "a", "p_hat", "gain", "stiffness", "authority", "dither"),
    "Arm": ("tip", "q", "qd", "torque", "wanted", "applied"),
    "Computer": ("lateness", "compute", "state", "clamped", "position_age", "force_age"),
}
"""Signals of a recording, by what they are about."""
HEAD = ("signal", "samples", "largest", "at [s]", "tolerance", "parts at [s]")
FLOWN, FIRST_AGAIN = 0, 1
"""Colours: what flew; what was computed anew, from here on."""


def flight_report(
    path: Path,
    recording: "FlightRecording",
    again: Mapping[str, Mapping[str, np.ndarray]],
    rows: Mapping[str, "Sequence[Difference]"],
) -> None:
    """Write the report of a flight.

    Args:
        path: Where it goes.
        recording: What flew.
        again: By program, the signals that it computed anew, (samples, width).
        rows: By program, how they differ.

    Raises:
        InputError: The file cannot be written.
    """
    header = recording.header
    time = recording.signals["time"][:, 0]
    lead = [
        f"{len(time)} samples, {time[0]:.3f} to {time[-1]:.3f} s; written because: {header.get('reason') or '-'}.",
        f"Controller sha256 {header.get('artifact')}.",
    ]
    tables = [Table(HEAD, list(map(_row, found)), name) for name, found in rows.items()]
    told = Section("Computed anew", ["How far each program is from what flew."], tables)
    signals = [
        Section(title, [], (), charts)
        for title, names in GROUPS.items()
        if (charts := [chart for name in names for chart in _charts(name, recording, again)])
    ]
    try:
        write_report(Report(f"Flight {path.stem}", lead, None, [*signals, told]), path)
    except OSError as error:
        raise InputError("--report", path, "a file that can be written", f"{error}.") from None


def _row(found: "Difference") -> list[str]:
    first = f"{found.first:.3f}" if found.parts else "–"
    numbers = [f"{found.largest:.3g} {found.unit}", f"{found.at:.3f}", f"{found.tolerance:.1g}", first]
    return [found.signal, str(found.samples), *numbers]


def _charts(name: str, recording: "FlightRecording", again: Mapping[str, Mapping[str, np.ndarray]]) -> list[Chart]:
    """A chart for each component of a signal, with what was computed anew dashed over it."""
    from deploy.flight.recorder import COLUMNS

    if name not in recording.signals:
        return []
    time, values = recording.signals["time"][:, 0], recording.signals[name]
    if not np.isfinite(values).any():
        return []
    width, unit = values.shape[1], COLUMNS.get(name, (0, "-"))[1] or "-"
    parts = {1: ("",), 3: AXES, 4: JOINTS}.get(width, tuple(map(str, range(width))))
    charts = []
    for k, part in enumerate(parts):
        series = [Series("flown", *thinned(time, values[:, k]), FLOWN)]
        if name == "force":
            series.append(Series("wanted", *thinned(time, recording.signals["force_ref"][:, k]), 7))
        for color, (program, signals) in enumerate(again.items(), FIRST_AGAIN):
            if name in signals:
                series.append(Series(program, *thinned(time, signals[name][:, k]), color, "dash"))
        charts.append(Chart(f"{name} {part}".strip(), "time [s]", f"{name} [{unit}]", series))
    return charts
