"""What random trials come to: fractions with their intervals, pairs, the worst of them, a table and a figure."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.files.sealed import write_atomic
from jaxmpc.files.toml import write_toml
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from jaxmpc.status import Status
from tuning.job.scenarios import describe
from tuning.trials import LARGEST_ERROR, Job, Outcomes


class Pairs(NamedTuple):
    """How often which of two controllers was lost in the same trial."""

    both: int
    only_first: int
    only_second: int
    neither: int


def pairs(lost: np.ndarray) -> Pairs:
    """Count the trials, (trials, 2)."""
    first, second = lost.T
    return Pairs(
        *(int(np.sum(which)) for which in (first & second, first & ~second, ~first & second, ~first & ~second))
    )


def ranked(found: Outcomes, controller: int, count: int) -> list[int]:
    """The trials with the largest |e| of a controller, worst first; those that diverged lead."""
    largest = np.nan_to_num(found.peak_error[:, controller].max(axis=-1), nan=np.inf)
    stable = found.status[:, controller] == Status.OK
    return [int(i) for i in np.lexsort((np.arange(len(largest)), -largest, stable))[:count]]


def draws(trial: Experiment) -> str:
    """What sets a trial apart, in a few words."""
    cable = f" of ζ {trial.arm.cable_damping:.3f}" if trial.arm.cable_hz else ""
    return f"{trial.stiffness[0]:.0f} N/m; {describe(trial)}{cable}"


def write_csv(path: Path, job: Job, names: Sequence[str], found: Outcomes) -> None:
    """Every trial a row: what was drawn, and what it did to each controller.

    Args:
        path: Where it goes.
        job: Draws the trials.
        names: Of the controllers.
        found: What happened.
    """
    vector = [f"{kind}_{axis} [N]" for kind in ("rms", "true_rms", "peak_error", "swing") for axis in AXES]
    each = ["lost", "left 2 N", "swinging", "status", "when [s]", "backed_off [s]", "spectral_radius [-]", *vector]
    drawn = ["trial", "motion", "motion_seed", "stiffness [N/m]", "delay [samples]", "mass_error [-]"]
    drawn += [f"friction_J{j} [-]" for j in range(1, 5)] + ["cable [Hz]", "cable_damping [-]"]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(drawn + [f"{name}: {column}" for name in names for column in each])
    verdicts = np.stack([found.lost, found.left, found.swinging], axis=-1).astype(int)
    for i in range(len(found.status)):
        row = [i, *_drawn(job.trial(i))]
        for c in range(len(names)):
            row += [*verdicts[i, c], Status(int(found.status[i, c])).name]
            row += [_short(field[i, c]) for field in (found.when, found.backed_off, found.spectral_radius)]
            vectors = (found.rms, found.true_rms, found.peak_error, found.swing)
            row += [_short(x) for field in vectors for x in field[i, c]]
        rows.writerow(row)
    write_atomic(path, text.getvalue().encode())


def write_trial(path: Path, trial: Experiment, comment: str) -> None:
    """A trial as an experiment's file, for `jaxmpc simulate`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_toml(path, trial.to_dict(), comment)


def trials_figure(path: Path, names: Sequence[str], found: Outcomes) -> None:
    """Which share of the trials has a larger peak error, and a larger RMS, on the worst axis.

    Args:
        path: Where it goes.
        names: Of the controllers, the one that is judged first.
        found: What happened.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    with figure(path, 1, 2, size=(8.0, 3.2)) as axes:
        for panel, field, title in zip(axes, (found.peak_error, found.rms), ("largest |e|", "RMS"), strict=True):
            for c, (name, color) in enumerate(zip(names, (TUNED, BASELINE), strict=False)):
                # What diverged lies beyond every limit.
                values = np.sort(np.nan_to_num(field[:, c].max(axis=-1), nan=np.inf))
                panel.step(values, 1.0 - np.arange(1, len(values) + 1) / len(values), color=color, label=name)
            panel.set_xscale("log")
            panel.set_yscale("log")
            # Of less than a decade, which has no power of ten in it, the minor ticks are all the numbers there are.
            panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_ylim(0.5 / len(values), 1.0)
            panel.set_xlabel(f"{title} after 2 s, worst axis [N]")
        axes[0].axvline(LARGEST_ERROR, color=ACCENT, lw=1.0, ls="--", label="2 N")
        axes[0].set_ylabel(f"share of {len(found.status)} trials beyond [-]")
        axes[0].legend()


def _drawn(trial: Experiment) -> list[Any]:
    motion, arm = trial.motion, trial.arm
    name = motion.kind if motion.kind != "rhythm" else f"{motion.rhythm}/{motion.ventilation}"
    joints = zip(arm.coulomb, arm.nominal_coulomb or arm.coulomb, strict=True)
    friction = [true / nominal if nominal else 1.0 for true, nominal in joints]
    cable = [_short(x) if arm.cable_hz else "" for x in (arm.cable_hz, arm.cable_damping)]
    numbers = [_short(trial.stiffness[0]), trial.delay, _short(arm.mass_error), *map(_short, friction)]
    return [name, motion.seed, *numbers, *cable]


def _short(value: float) -> str:
    return "" if not np.isfinite(value) else f"{value:.7g}"
