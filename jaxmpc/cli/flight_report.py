"""A flight as a report: what flew over what was computed anew, and how far they part."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.quantities import AXES
from jaxmpc.report.content import Chart, Report, Section, Series, Table
from jaxmpc.report.page import write_report
from jaxmpc.report.thinning import thinned

if TYPE_CHECKING:
    from deploy.flight.recorder import FlightRecording
    from deploy.flight.replay import Difference
    from jaxmpc.law.recorded import RecordedInputs

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
    name: str,
    recording: "FlightRecording",
    inputs: "RecordedInputs",
    again: Mapping[str, Mapping[str, np.ndarray]],
    rows: "Mapping[str, Sequence[Difference]]",
    verdict: str,
) -> None:
    """Write the report.

    Args:
        path: Where it goes.
        name: Of the recording.
        recording: What flew.
        inputs: What the law was given.
        again: By program, the signals that it computed anew, (samples, width).
        rows: By program, how they differ.
        verdict: Whether they part, and where first.

    Raises:
        OSError: The file cannot be written.
    """
    header = recording.header
    time = recording.signals["time"][:, 0]
    lead = [
        f"{len(time)} samples, {time[0]:.3f} to {time[-1]:.3f} s; written because: {header.get('reason') or '-'}.",
        f"Computed anew by {' and '.join(again)}: {verdict}.",
        f"Controller sha256 {header.get('artifact')}.",
    ]
    # Where a recording begins in the middle of a contact, what is computed anew has yet to find the observers' states.
    drawn = {
        program: {signal: np.where(inputs.judged[:, None], values, np.nan) for signal, values in signals.items()}
        for program, signals in again.items()
    }
    tables = [Table(HEAD, list(map(_row, found)), program) for program, found in rows.items()]
    told = Section("Computed anew", ["How far each program is from what flew."], tables)
    signals = [_section(title, names, recording, drawn) for title, names in GROUPS.items()]
    write_report(Report(f"Flight {name}", lead, None, [*signals, told]), path)


def _section(
    title: str, names: Sequence[str], recording: "FlightRecording", again: Mapping[str, Mapping[str, np.ndarray]]
) -> Section:
    """A chart for each component of these signals that moves; those that never do take a sentence."""
    charts, still = [], []
    for name in names:
        if name not in recording.signals:
            continue
        values = recording.signals[name]
        if not np.isfinite(values).any():
            continue
        if (low := np.nanmin(values)) == np.nanmax(values) and name != "state":
            still.append(f"{name} {low:g} {_unit(name)}".removesuffix(" -"))
        else:
            charts += _charts(name, recording, again)
    return Section(title, [f"The same throughout: {', '.join(still)}."] if still else [], (), charts)


def _row(found: "Difference") -> list[str]:
    first = f"{found.first:.3f}" if found.parts else "–"
    numbers = [f"{found.largest:.3g} {found.unit}", f"{found.at:.3f}", f"{found.tolerance:.1g}", first]
    return [found.signal, str(found.samples), *numbers]


def _charts(name: str, recording: "FlightRecording", again: Mapping[str, Mapping[str, np.ndarray]]) -> list[Chart]:
    """A chart for each component of a signal, with what was computed anew dashed over it."""
    time, values = recording.signals["time"][:, 0], recording.signals[name]
    width = values.shape[1]
    parts = {1: ("",), 3: AXES, 4: JOINTS}.get(width, tuple(map(str, range(width))))
    label = f"{name} [{_unit(name)}]"
    if name == "state":
        label = _states(recording)
    charts = []
    for k, part in enumerate(parts):
        series = [Series("flown", *thinned(time, values[:, k]), FLOWN)]
        if name == "force":
            series.append(Series("wanted", *thinned(time, recording.signals["force_ref"][:, k]), 7))
        for color, (program, signals) in enumerate(again.items(), FIRST_AGAIN):
            if name in signals:
                series.append(Series(program, *thinned(time, signals[name][:, k]), color, "dash"))
        span = float(time[0]), float(time[-1])
        charts.append(Chart(f"{name} {part}".strip(), "time [s]", label, series, x_range=span))
    return charts


def _unit(name: str) -> str:
    from deploy.flight.recorder import COLUMNS

    return COLUMNS.get(name, (0, "-"))[1] or "-"


def _states(recording: "FlightRecording") -> str:
    """Which number stands for which of the states that occur."""
    known = recording.header.get("names", {}).get("state", ())
    numbers = np.unique(recording.signals["state"][np.isfinite(recording.signals["state"])]).astype(int)
    return ", ".join(f"{number} {known[number]}" for number in numbers if 0 <= number < len(known))
