"""A flight as its recording has it: forces measured and wanted, states by name, what clamps and guard did."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.pictures.experiment_figures import COLOURS
from jaxmpc.pictures.figures import ACCENT, BASELINE, figure, outline
from jaxmpc.quantities import AXES

SHADES = {"approach": "#e8c468", "contact": "#9fd3c7", "retract": "#b8b8d1", "fault": ACCENT}
"""Background of a state; the others have none."""
JOINTS = ("#23272e", "#b07d2b", "#7d5ba6", BASELINE)
"""J1 to J4."""
ROOM = 0.05
"""Share of the picture's width that a state's name takes."""


def recording_figure(
    path: Path,
    signals: Mapping[str, np.ndarray],
    names: Mapping[str, Sequence[str]],
    title: str,
    parted: str,
    guarded: bool,
) -> None:
    """Draw a flight recording.

    Args:
        path: Where it goes.
        signals: Arrays (samples, width) by name, `deploy.flight.recorder`.
        names: What the numbers of `state` and `reason` stand for.
        title: Above it: who flew, and how it ended.
        parted: What a replay found, below it.
        guarded: Whether the controller has a guard; every recording has a gain, which is 1 without one.
    """
    t = signals["time"][:, 0]
    force, wanted = signals["force"], signals["force_ref"]
    in_contact = _state(signals, names) == "contact"
    # Before contact K̂ is where the search begins, and nothing is known of a tissue.
    believed = np.where(in_contact[:, None], signals.get("stiffness", np.nan), np.nan)
    known = bool(np.any(believed > 0.0))
    with figure(path, rows=4 + (guarded or known), size=(9.0, 10.0)) as axes:
        panels, torques, last = axes[:3], axes[3], axes[-1]
        for axis, (panel, colour) in enumerate(zip(panels, COLOURS, strict=True)):
            panel.plot(*outline(t, force[:, axis]), color=colour, lw=0.8, label="measured")
            panel.plot(*outline(t, wanted[:, axis]), color="black", lw=0.9, ls="--", label="wanted")
            panel.set_ylabel(f"force {AXES[axis].upper()} [N]")
            _lost(panel, t, force[:, axis], in_contact)
        for joint, colour in enumerate(JOINTS):
            torques.plot(*outline(t, signals["torque"][:, joint]), color=colour, lw=0.7, label=f"J{joint + 1}")
        clamped = (signals["clamped"][:, 0] > 0.0) & in_contact
        label = f"{clamped.sum()} clamped in contact"
        torques.plot(t[clamped], np.zeros(clamped.sum()), "|", color=ACCENT, ms=10.0, label=label)
        torques.set_ylabel("torque [N m]")
        if guarded:
            last.plot(*outline(t, signals["gain"][:, 0]), color="black", lw=1.0, label="gain left by the guard")
            last.set_ylim(-0.05, 1.05)
            last.set_ylabel("gain [-]")
        if known:
            stiffness = last.twinx() if guarded else last
            for axis, colour in enumerate(COLOURS):
                stiffness.plot(t, believed[:, axis], color=colour, lw=0.8, label=f"K̂ {AXES[axis].upper()}")
            stiffness.set_ylabel("stiffness believed [N/m]")
            if guarded:
                stiffness.grid(visible=False)
                stiffness.legend(loc="upper left", ncols=3, borderaxespad=0.1, fontsize=8.0)
                _leave_room(stiffness)
        for panel in axes:
            _shade(panel, t, _state(signals, names), named=panel is panels[0])
            panel.set_xlim(t[0], t[-1])
            _leave_room(panel)
            panel.legend(loc="upper right", ncols=6, borderaxespad=0.1, fontsize=8.0)
        for panel in axes[:-1]:
            panel.tick_params(labelbottom=False)
        panels[0].set_title(title, loc="left", pad=18.0, parse_math=False)
        last.set_xlabel(f"time since the first cycle [s]; {parted}")
        last.figure.align_ylabels(axes)


def _state(signals: Mapping[str, np.ndarray], names: Mapping[str, Sequence[str]]) -> np.ndarray:
    known = np.array([*names.get("state", ()), "?"])
    numbers = np.nan_to_num(signals["state"][:, 0], nan=-1.0).astype(int)
    found: np.ndarray = known[np.where((numbers >= 0) & (numbers < len(known) - 1), numbers, -1)]
    return found


def _leave_room(panel: Any) -> None:
    """Room above the signals for the legend."""
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.25 * (high - low))


def _shade(panel: Any, t: np.ndarray, state: np.ndarray, *, named: bool) -> None:
    """Stretches of the same state, named above them, or in the legend where there is no room."""
    edges = [0, *(np.flatnonzero(state[1:] != state[:-1]) + 1), len(t) - 1]
    for first, last in pairwise(edges):
        name = str(state[first])
        span = panel.axvspan(t[first], t[last], color=SHADES.get(name, "white"), alpha=0.25, lw=0.0)
        # A name that has no room would lie over its neighbour's.
        if named and t[last] - t[first] <= ROOM * (t[-1] - t[0]):
            span.set_label(name if name in SHADES and name not in panel.get_legend_handles_labels()[1] else "")
        elif named:
            middle = 0.5 * (t[first] + t[last])
            where = panel.get_xaxis_transform()
            panel.text(middle, 1.02, name, ha="center", va="bottom", fontsize=8.0, color=BASELINE, transform=where)


def _lost(panel: Any, t: np.ndarray, force: np.ndarray, in_contact: np.ndarray) -> None:
    """Samples without a force; those that the law missed in contact stand out."""
    low, missing = panel.get_ylim()[0], ~np.isfinite(force)
    for which, colour, where in (
        (missing & in_contact, ACCENT, "in contact"),
        (missing & ~in_contact, BASELINE, "outside contact"),
    ):
        if which.any():
            label = f"{which.sum()} without a force {where}"
            panel.plot(t[which], np.full(which.sum(), low), "|", color=colour, ms=8.0, label=label)
