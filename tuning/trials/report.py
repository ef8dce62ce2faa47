"""What random trials come to: fractions with their intervals, pairs, the worst of them, a table and a report."""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.files.sealed import write_atomic
from jaxmpc.files.toml import toml_text, write_toml
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.report.content import Candidates, Chart, Detail, Mark, Measure, Report, Section, Series, Table, measure
from jaxmpc.report.influence import influence
from jaxmpc.status import Status
from tuning.job.scenarios import describe
from tuning.trials.drawn import SETTLE, Drawn, Job
from tuning.trials.outcomes import LARGEST_ERROR, Outcomes

KEPT = 20
"""Worst trials of each controller that a report keeps as files."""


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


def failures(job: Job, names: Sequence[str], first: int, found: Outcomes) -> Iterator[str]:
    """A line for each trial that failed, and how.

    Args:
        job: Draws the trials.
        names: Of the controllers.
        first: Number of the first of these trials.
        found: What happened in them.
    """
    verdicts = {"lost": found.lost, "left 2 N": found.left, "swinging": found.swinging}
    for i, c in np.argwhere(np.any(list(verdicts.values()), axis=0)).tolist():
        said = " and ".join(verdict for verdict, which in verdicts.items() if which[i, c])
        status, when = Status(int(found.status[i, c])), found.when[i, c]
        if status != Status.OK:
            said += f", {status.name}" + (f" at {when:.1f} s" if np.isfinite(when) else "")
        largest = found.peak_error[i, c].max()
        said += f", |e| {largest:.2f} N" if np.isfinite(largest) else ""
        yield f"trial {first + i}: {names[c]} {said}; {draws(job.trial(first + i))}"


def write_csv(path: Path, drawn: Drawn, names: Sequence[str], found: Outcomes) -> None:
    """Every trial a row: what was drawn, and what it did to each controller.

    Args:
        path: Where it goes.
        drawn: What sets each apart.
        names: Of the controllers.
        found: What happened.
    """
    vector = [f"{kind}_{axis} [N]" for kind in ("rms", "true_rms", "peak_error", "swing") for axis in AXES]
    each = ["lost", "left 2 N", "swinging", "status", "when [s]", "backed_off [s]", "spectral_radius [-]", *vector]
    head = ["trial", "motion", "motion_seed", "stiffness [N/m]", "delay [samples]", "mass_error [-]"]
    head += [f"friction_J{j} [-]" for j in range(1, 5)] + ["cable [Hz]", "cable_damping [-]"]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(head + [f"{name}: {column}" for name in names for column in each])
    cable = np.where(drawn.cable_hz != 0.0, [drawn.cable_hz, drawn.cable_damping], np.nan)
    robots = np.column_stack([drawn.stiffness, drawn.mass_error, drawn.friction, *cable]).tolist()
    words = zip(drawn.motion.tolist(), drawn.motion_seed.tolist(), drawn.delay.tolist(), robots, strict=True)
    verdicts = np.stack([found.lost, found.left, found.swinging], axis=-1).astype(int)
    scalars = np.stack([found.when, found.backed_off, found.spectral_radius], axis=-1)
    numbers = np.concatenate([scalars, found.rms, found.true_rms, found.peak_error, found.swing], axis=-1)
    for i, (motion, seed, delay, robot) in enumerate(words):
        stiffness, *others = _short(*robot)
        row = [i, motion, seed, stiffness, delay, *others]
        for c in range(len(names)):
            row += [*verdicts[i, c].tolist(), Status(int(found.status[i, c])).name, *_short(*numbers[i, c].tolist())]
        rows.writerow(row)
    write_atomic(path, text.getvalue().encode())


def write_trial(path: Path, trial: Experiment, comment: str) -> None:
    """A trial as an experiment's file, for `jaxmpc simulate`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = trial.to_dict()
    if file := data["motion"]["file"]:
        data["motion"]["file"] = str(Path(file).absolute())  # else it would be looked for beside the trial
    write_toml(path, data, comment)


def trials_report(job: Job, drawn: Drawn, names: Sequence[str], found: Outcomes, verdicts: Table) -> Report:
    """Every trial a row: what was drawn, and what it did to each controller.

    Args:
        job: Who met what.
        drawn: What sets each trial apart.
        names: Of the controllers, the one that is judged first.
        found: What happened.
        verdicts: How often which verdict fell.
    """
    count = len(found.status)
    shares = Section("Verdicts", [f"{count} trials on {job.spread.arms} arms."], [verdicts], _shares(names, found))
    lead = [f"{job.base.name}, seed {job.seed}, {job.base.duration:g} s each."]
    return Report(f"Trials of {' against '.join(names)}", lead, _rows(job, drawn, names, found), [shares], 1)


def _shares(names: Sequence[str], found: Outcomes) -> list[Chart]:
    """Which share of the trials has a larger peak error, and a larger RMS, on the worst axis."""
    charts = []
    for field, title, marks in (
        (found.peak_error, "largest |e|", [Mark("2 N", x=LARGEST_ERROR)]),
        (found.rms, "RMS", []),
    ):
        series = []
        for c, name in enumerate(names):
            values = np.sort(field[:, c].max(axis=-1))
            # What diverged lies beyond every limit.
            share = 1.0 - np.arange(1, len(values) + 1) / len(values)
            series.append(Series(name, values, share, c))
        label = f"{title} after {SETTLE:g} s, worst axis [N]"
        charts.append(Chart(title, label, f"share of {len(found.status)} trials beyond [-]", series, marks, True, True))
    return charts


def _rows(job: Job, drawn: Drawn, names: Sequence[str], found: Outcomes) -> Candidates:
    """The trials as rows that can be explored; the controllers stand where tissues do elsewhere."""
    columns = {
        "stiffness": ("N/m", "stiffness of the tissue", drawn.stiffness),
        "delay": ("samples", "between command and effect", drawn.delay),
        "mass_error": ("-", "of the masses believed", drawn.mass_error),
        "cable": ("Hz", "mode of the cables", drawn.cable_hz),
        "cable damping": ("-", "of that mode", drawn.cable_damping),
    }
    for joint, factor in enumerate(drawn.friction.T):
        columns[f"friction J{joint + 1}"] = ("-", "true over believed", factor)
    count = len(drawn.delay)
    parameters = [
        Measure(name, name, unit, text, values.astype(float), "parameter", whole=name == "delay")
        for name, (unit, text, values) in columns.items()
        if (values != values[0]).any()
    ]
    found_of = {
        "rms": found.rms,
        "true_rms": found.true_rms,
        "peak_error": found.peak_error,
        "swing": found.swing,
    }
    results = [
        measure(METRICS[name], values, LARGEST_ERROR if name == "peak_error" else None)
        for name, values in found_of.items()
    ]
    radius = measure(MARGINS["spectral_radius"], found.spectral_radius)
    lost = Measure("lost", "lost", "-", "1 where it was", found.lost.astype(float), "other", "ceiling", whole=True)
    chosen = dict.fromkeys(i for c in range(len(names)) for i in ranked(found, c, KEPT))
    worst = [(i, job.trial(i)) for i in chosen]
    return Candidates(
        names=[f"trial {i}" for i in range(count)],
        measures=[*parameters, *results, radius, lost],
        status=found.status.astype(np.uint8),
        tissues=list(names),
        goals=("rms", "peak_error", "swing"),
        details={
            i: Detail(toml=toml_text(trial.to_dict(), f"Trial {i}, seed {job.seed}: {draws(trial)}"))
            for i, trial in worst
        },
        note=f"the {KEPT} worst trials of each controller, as experiments for `jaxmpc simulate`.",
        influence=influence(parameters, results) if count > 1 else {},
        group="controller",
        file="trial.toml",
    )


def _short(*values: float) -> list[str]:
    """Numbers as they stand in a table, empty where there is none; a hundred thousand rows have four million."""
    text = " ".join(["%.7g"] * len(values)) % values
    return text.replace("nan", "").replace("inf", "").split(" ")
