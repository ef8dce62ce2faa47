"""Figures of one experiment, laid out as the paper's Figs. 3 and 4."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure, outline
from jaxmpc.spectra.disturbance import RECORD, Peaks, disturbance, peaks, power_spectral_density
from jaxmpc.status import Status

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome

COLOURS = (TUNED, "#3a7d44", ACCENT)
"""X, Y, Z."""
QUIET = "#5b616b"
"""Without motion: what the noise alone leaves, over which the rest stands."""
TITLE = 76
"""Characters of a title's line."""
USABLE = (int(Status.OK), int(Status.LOST_CONTACT))
"""Statuses of runs that went on to their end."""
SHOWN_HZ = 8.0
"""Where the spectrum ends: the paper's last peak is at 6.32 [Hz]."""


def held(outcome: "Outcome", still: "Outcome") -> list[int]:
    """Places of the stiffnesses at which both runs went on to their end.

    Losing contact is no obstacle. A run that ended otherwise has no residual; it is told in words.
    """
    pairs = zip(np.asarray(outcome.status), np.asarray(still.status), strict=True)
    return [row for row, pair in enumerate(pairs) if all(int(code) in USABLE for code in pair)]


def row_to_draw(outcome: "Outcome", still: "Outcome") -> int | None:
    """The stiffness with the largest residual of those that held; None where there is none."""
    worst = np.nan_to_num(np.asarray(outcome.metrics.rms), nan=0.0).max(axis=-1)
    return max(held(outcome, still), key=lambda row: float(worst[row]), default=None)


def drawn_of(outcome: "Outcome", still: "Outcome") -> str:
    """What the stiffness that is drawn is the worst of, in words; "" of one alone."""
    all_of_them, those = len(np.asarray(outcome.status)), len(held(outcome, still))
    if all_of_them == 1:
        return ""
    return f", the worst of {those}" + ("" if those == all_of_them else f" that held, of {all_of_them}")


def disturbance_seen(experiment: Experiment, outcome: "Outcome", still: "Outcome", row: int) -> np.ndarray:
    """The paper's Fig. 3a from a run with and one without heart motion, shape (3, steps) [N]."""
    assert outcome.trace is not None
    assert still.trace is not None
    moving, quiet = outcome.trace, still.trace
    return disturbance(
        experiment.stiffness[row], moving.tip[row], quiet.tip[row], moving.force[row], wanted_of(experiment)
    )


def wanted_of(experiment: Experiment) -> np.ndarray:
    """Wanted force of every sample itself, shape (3, steps) [N]; a trace has what the controller was told ahead."""
    wanted: np.ndarray = experiment.signals.force_ref[: experiment.steps].T
    return wanted


def title_of(experiment: Experiment, controller: str, row: int, drawn: str, notes: str) -> str:
    """What ran on which tissue, and below it what there is to know, in lines that the figure holds."""
    ran = f"{experiment.name}, {controller}, K_s = {experiment.stiffness[row]:g} N/m{drawn}"
    return "\n".join([*textwrap.wrap(ran, TITLE), *textwrap.wrap(notes, TITLE)])


def experiment_figure(
    path: Path, experiment: Experiment, controller: str, outcome: "Outcome", still: "Outcome", row: int
) -> None:
    """Disturbance, force and residual over time, as the paper's Fig. 3.

    Args:
        path: Where it goes.
        experiment: What was run.
        controller: Its name.
        outcome: Its outcome, with trace.
        still: The same without heart motion, with trace.
        row: Which stiffness.
    """
    assert outcome.trace is not None
    assert still.trace is not None
    t = np.arange(experiment.steps) * experiment.sampling_time
    wanted, force = wanted_of(experiment), np.asarray(outcome.trace.force)[row]
    residual, quiet = force - wanted, np.asarray(still.trace.force)[row] - wanted
    felt = disturbance_seen(experiment, outcome, still, row)
    scored = experiment.signals.score
    # Of one scale, so that the axes compare; what is not scored (a ramp, the first contact) may leave it.
    bound = 1.45 * max(float(np.abs(residual.T[scored]).max()), 1e-3)

    with figure(path, rows=5, size=(8.0, 9.6)) as axes:
        top, applied, *panels = axes
        for axis, colour in enumerate(COLOURS):
            top.plot(*outline(t, felt[axis]), color=colour, lw=0.9, label=AXES[axis].upper())
            applied.plot(*outline(t, force[axis]), color=colour, lw=0.9, label=AXES[axis].upper())
            applied.plot(
                *outline(t, wanted[axis]), color="black", lw=0.9, ls="--", label="wanted" if axis == 2 else None
            )
            panel, counts = panels[axis], scored[:, axis]
            rms = [1e3 * np.sqrt(np.mean(x[axis, counts] ** 2)) for x in (residual, quiet)]
            panel.plot(*outline(t, residual[axis]), color=colour, lw=0.6, label=f"Heartbox on, RMS {rms[0]:.0f} mN")
            panel.plot(*outline(t, quiet[axis]), color=QUIET, lw=0.5, label=f"Heartbox off, RMS {rms[1]:.0f} mN")
            panel.set_ylabel(f"residual {AXES[axis].upper()} [N]")
            panel.set_ylim(-bound, bound)
            panel.legend(ncols=2, loc="upper right", borderaxespad=0.1)
            if experiment.settle:
                panel.axvspan(0.0, experiment.settle, color=BASELINE, alpha=0.15, lw=0.0)
        lost = float(outcome.when[row]) if outcome.status[row] == Status.LOST_CONTACT else None
        notes = ["shaded: not scored"] if experiment.settle else []
        notes += [] if lost is None else [f"dotted: contact lost at {lost:.1f} s"]
        title = title_of(experiment, controller, row, drawn_of(outcome, still), "; ".join(notes))
        top.set_title(title, loc="left", parse_math=False)
        top.set_ylabel("disturbance [N]")
        applied.set_ylabel("applied force [N]")
        for panel in (top, applied):
            low, high = panel.get_ylim()
            panel.set_ylim(low, high + 0.22 * (high - low))
            panel.legend(ncols=4, loc="upper right", borderaxespad=0.1)
        for panel in axes:
            panel.set_xlim(0.0, experiment.duration)
            if lost is not None:
                # Ends below the legend.
                panel.axvline(lost, ymax=0.85, color="black", lw=0.8, ls=":")
        for panel in axes[:-1]:
            panel.tick_params(labelbottom=False)
        panels[-1].set_xlabel("time [s]")
        panels[-1].figure.align_ylabels(axes)


def spectrum_figure(
    path: Path, experiment: Experiment, controller: str, outcome: "Outcome", still: "Outcome", row: int
) -> Peaks:
    """Power spectral density of the disturbance with its peaks marked, as the paper's Fig. 4.

    Args:
        path: Where it goes.
        experiment: What was run.
        controller: Its name.
        outcome: Its outcome, with trace.
        still: The same without heart motion, with trace.
        row: Which stiffness.

    Returns:
        The peaks, found in the last `RECORD` seconds that are scored.
    """
    T_s = experiment.sampling_time
    seconds = min(RECORD, experiment.duration - experiment.settle)
    felt = disturbance_seen(experiment, outcome, still, row)[:, -round(seconds / T_s) :]
    found, spectrum = peaks(felt, T_s, experiment.stiffness[row]), power_spectral_density(felt, T_s)
    shown = (spectrum.frequency > 0.0) & (spectrum.frequency <= SHOWN_HZ)
    highest = spectrum.density[:, shown].max()
    with figure(path, size=(8.0, 4.2)) as panel:
        for axis, colour in enumerate(COLOURS):
            density = spectrum.density[axis]
            panel.semilogy(spectrum.frequency[shown], density[shown], color=colour, lw=1.1, label=AXES[axis].upper())
        for frequency in found.frequency:
            panel.axvline(frequency, color=BASELINE, lw=0.8, ls=":", zorder=0.5)
            label = {"ha": "center", "va": "bottom", "fontsize": 8.5, "rotation": 90.0, "backgroundcolor": "white"}
            panel.annotate(f"{frequency:.2f}", (frequency, 2.5 * highest), **label)
        panel.set_ylim(1e-6 * highest, 30.0 * highest)
        panel.set_xlim(0.0, SHOWN_HZ)
        panel.set_xlabel("frequency [Hz]")
        panel.set_ylabel("disturbance [N²/Hz]")
        notes = f"{seconds:g} s, bins of {1.0 / seconds:.2g} Hz, Hann window; peaks in Hz"
        title = title_of(experiment, controller, row, drawn_of(outcome, still), notes)
        panel.set_title(title, loc="left", parse_math=False)
        panel.legend(loc="upper right")
    return found
