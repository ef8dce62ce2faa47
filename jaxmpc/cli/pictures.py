"""Figures of one experiment, laid out as the paper's Fig. 3."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.figures import ACCENT, BASELINE, TUNED, figure

if TYPE_CHECKING:
    from jaxmpc.evaluation import Outcome

COLOURS = (TUNED, "#3a7d44", ACCENT)
"""X, Y, Z."""


def experiment_figure(path: Path, experiment: Experiment, outcome: "Outcome", still: "Outcome") -> None:
    """Disturbance, force and residual over time, at the middle stiffness.

    Args:
        path: Where it goes.
        experiment: What was run.
        outcome: Its outcome, with trace.
        still: The same without heart motion, with trace.
    """
    assert outcome.trace is not None
    assert still.trace is not None
    row = len(experiment.stiffness) // 2
    t = np.arange(experiment.steps) * experiment.sampling_time
    # The paper's disturbance (Fig. 3a): how much more the tip moved, as force, and what was left of it.
    moved = experiment.stiffness[row] * np.asarray(outcome.trace.tip - still.trace.tip)[row]
    wanted = np.asarray(outcome.trace.force_ref)[row, :, :, 0]
    force = np.asarray(outcome.trace.force)[row]
    disturbance = moved + (wanted - force)

    with figure(path, rows=5, size=(8.0, 9.0)) as axes:
        top, applied, *residuals = axes
        for axis, colour in enumerate(COLOURS):
            top.plot(t, disturbance[axis], color=colour, lw=0.8, label=AXES[axis].upper())
            applied.plot(t, force[axis], color=colour, lw=0.8)
            applied.plot(t, wanted[axis], color="black", lw=0.8, ls="--")
            residual = residuals[axis]
            residual.plot(t, (force - wanted)[axis], color=colour, lw=0.5, label="heart moving")
            quiet = np.asarray(still.trace.force)[row, axis] - wanted[axis]
            residual.plot(t, quiet, color=BASELINE, lw=0.5, label="heart still")
            residual.set_ylabel(f"residual {AXES[axis].upper()} [N]")
            scored = np.abs((force - wanted)[axis][experiment.signals.score[:, axis]]).max()
            residual.set_ylim(-1.6 * scored, 1.6 * scored)
        top.set_title(f"{experiment.name}, K_s = {experiment.stiffness[row]:g} N/m")
        top.set_ylabel("disturbance [N]")
        top.legend(ncols=3, loc="upper right")
        applied.set_ylabel("force, wanted (dashed) [N]")
        residuals[0].legend(ncols=2, loc="upper right")
        residuals[-1].set_xlabel("time [s]")


def before_after_figure(path: Path, experiment: Experiment, outcome: "Outcome", seconds: float = 8.0) -> None:
    """Residual on Z over time of two controllers, one panel per stiffness.

    Args:
        path: Where it goes.
        experiment: What was run.
        outcome: A batch of two, before and after, with trace.
        seconds: How much of the run's end is shown [s].
    """
    assert outcome.trace is not None
    force, wanted = np.asarray(outcome.trace.force), np.asarray(outcome.trace.force_ref)[..., 0]
    shown = slice(-round(seconds / experiment.sampling_time), None)
    t = (np.arange(experiment.steps) * experiment.sampling_time)[shown]
    residual = (force - wanted)[:, :, 2, shown]
    with figure(path, rows=len(experiment.stiffness), size=(8.0, 1.7 * len(experiment.stiffness) + 0.6)) as axes:
        panels = np.atleast_1d(axes)
        for row, panel in enumerate(panels):
            for which, (label, colour) in enumerate((("paper's text design", BASELINE), ("autotuned", TUNED))):
                rms, M_s = outcome.metrics.rms[which, row, 2], outcome.margins.M_s[which, row]
                text = f"{label}: RMS {1e3 * rms:.0f} mN, $M_s$ {M_s:.2f}"
                panel.plot(t, 1e3 * residual[which, row], color=colour, lw=0.7, label=text)
            panel.set_ylim(*(1.45e3 * np.abs(residual).max() * np.array([-1.0, 1.0])))
            panel.set_ylabel(f"{experiment.stiffness[row]:g} N/m\nresidual Z [mN]")
            panel.legend(ncols=2, loc="upper right")
        panels[0].set_title("Force left over on a beating heart, on motion the tuner had not seen")
        panels[-1].set_xlabel("time [s]")
