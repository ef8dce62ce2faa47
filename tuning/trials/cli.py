"""`jaxmpc trials`: random robots, tissues, delays and rhythms for a finished controller, and how often it fails."""

import argparse
import sys
import time
from contextlib import AbstractContextManager, nullcontext
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError
from jaxmpc.terminal.arguments import engine_argument

if TYPE_CHECKING:
    from jaxmpc.beside import Apart
    from jaxmpc.report.content import Table
    from tuning.trials import Drawn, Job, Outcomes, Told

LISTED = 5
"""Worst trials told of each controller."""
TOLD = 20
"""Failures told as they come; all stand in the tables."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "params",
        help="a params.toml, a published set (text, cautious, family, …) or the folder of a tuning run; NAME=… "
        "gives it another name in tables and files",
    )
    parser.add_argument("--against", metavar="PARAMS", help="another controller in the same trials, `text` for example")
    parser.add_argument("--trials", type=int, default=10_000, help="how many (10000)")
    parser.add_argument(
        "--hard", action="store_true", help="stress arms: cables of 15–60 Hz, also two samples of delay"
    )
    parser.add_argument("--seed", type=int, default=0, help="draws other trials (0)")
    parser.add_argument(
        "--experiment",
        default="table-1-wam",
        help="what they are drawn around (table-1-wam); its own tissues, softest to hardest, if it has other than the "
        "paper's, else 300–2200 N/m",
    )
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="folder of table, report and finished blocks")
    engine_argument(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Run the trials, print what came of them; 1 if the controller (not the one against it) was lost in any.

    Raises:
        InputError: A controller, the experiment, a number or the folder is wrong; nothing has been written by then.
    """
    from jaxmpc.engine.registry import named
    from jaxmpc.engine.scenario import program_spec
    from jaxmpc.files.outputs import check_folder
    from jaxmpc.terminal.arguments import experiment_from, name_and_place, params_from
    from jaxmpc.terminal.process import may_have_a_gpu, use_all_cores
    from jaxmpc.terminal.tables import show

    use_all_cores()
    from jaxmpc.tracers import trace_apart

    trace_apart("tuning.trials.program")
    from jaxmpc.beside import Beside, forks_of

    if may_have_a_gpu():
        forks_of("tuning.trials.compute")  # who makes what trials meet imports it beside this process
    from jaxmpc.xla.place import wake_beside
    from tuning.trials import HARD, MOST, NOMINAL, Job, on_own_tissues
    from tuning.trials import run as run_trials
    from tuning.trials.linear_margins import COLUMNS, TISSUES, margins_table

    wake_beside()
    given = [name_and_place(text) for text in (args.params, args.against) if text is not None]
    controllers = tuple(params_from(place) for _, place in given)
    names = [name or place for name, place in given]
    names = names if len(set(names)) == len(names) else [names[0], f"{names[1]} (2)"]
    base = experiment_from(args.experiment)
    job = Job(controllers, base, on_own_tissues(HARD if args.hard else NOMINAL, base), args.seed, args.engine)
    named(program_spec(job.base), args.engine)
    check_folder("-o", args.out)
    if not 1 <= args.trials <= MOST:
        raise InputError("--trials", args.trials, f"in [1, {MOST}]", "10000 is usual.")
    print(
        f"{args.trials} trials of {job.base.duration:g} s on {job.spread.arms} arms, {job.base.name}, seed {args.seed}"
    )
    print(_drawn_from(job), flush=True)
    began, tell = time.monotonic(), None if args.quiet else _teller(job, names)
    try:
        blocks = args.out / "blocks" if args.out else None
        with Beside(1) as beside, _drawing(job, args.trials) if args.out else nullcontext() as drawing:
            # Of little work and much compiling, which the trials leave a core for while they compile themselves.
            margins = beside.submit(margins_table, names, job)
            found = run_trials(job, args.trials, blocks, not args.quiet, tell)
            print(f"{args.trials} trials × {len(names)} controllers after {time.monotonic() - began:.0f} s")
            verdicts = _tables(job, names, found)
            print()
            show(f"linear margins, the worst of {TISSUES} tissues", COLUMNS, margins.result())
            if drawing:
                _files(args.out, job, drawing.result(), names, found, verdicts)
    except BrokenPipeError:
        raise  # nobody reads what is told, which costs no block
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        print(
            f"jaxmpc trials: cannot write: {error.strerror or error}{where}. Finished blocks are kept.", file=sys.stderr
        )
        return 1
    failed = int(found.lost[:, 0].sum())
    if failed:
        print(f"jaxmpc trials: {names[0]} was lost in {failed} of {args.trials} trials", file=sys.stderr)
    return int(failed > 0)


class _Drawing:
    """What the trials of a job meet, drawn when it is asked for."""

    def __init__(self, job: "Job", count: int) -> None:
        self._job, self._count = job, count

    def result(self) -> "Drawn":
        return self._job.drawn(0, self._count)


def _drawing(job: "Job", count: int) -> "AbstractContextManager[_Drawing | Apart]":
    """What trials meet, for their table. It takes Python 9 s for 10⁵ of them, for which a GPU's user would wait."""
    from dataclasses import replace

    from jaxmpc.beside import Apart
    from jaxmpc.terminal.process import may_have_a_gpu

    drawing = _Drawing(replace(job, controllers=()), count)  # which may be arrays of a GPU
    return Apart(drawing.result) if may_have_a_gpu() else nullcontext(drawing)


def _teller(job: "Job", names: list[str]) -> "Told":
    """Says on standard error what failed, as it comes; after some lines only that there is more."""
    from tuning.trials.report import failures

    left = TOLD

    def tell(first: int, found: "Outcomes") -> None:
        nonlocal left
        if not left:
            return
        lines = list(islice(failures(job, names, first, found), left + 1))
        for line in lines[:left]:
            print(line, file=sys.stderr, flush=True)
        if len(lines) > left:
            print(
                "… and more; the counts go on, and with -o every trial stands in trials.csv",
                file=sys.stderr,
                flush=True,
            )
        left = max(0, left - len(lines))

    return tell


def _drawn_from(job: "Job") -> str:
    spread, drawn = job.spread, job.spread.scenarios
    words = [
        f"K_s {spread.stiffness[0]:g}–{spread.stiffness[1]:g} N/m",
        f"friction of each joint ±{100 * drawn.friction:g} %",
        f"masses ±{100 * drawn.mass:g} %",
        f"delay {' or '.join(map(str, drawn.delays))}",
    ]
    if drawn.cable_hz and spread.cable_damping:
        words.append(f"cable mode {drawn.cable_hz[0]:g}–{drawn.cable_hz[1]:g} Hz")
        words[-1] += f", ζ {spread.cable_damping[0]:g}–{spread.cable_damping[1]:g}"
    return "  " + "; ".join([*words, f"rhythms {', '.join(drawn.rhythms)}"])


def _tables(job: "Job", names: list[str], found: "Outcomes") -> "Table":
    """Print everything; the verdicts once more, for the report."""
    import numpy as np
    from scipy.stats import binomtest

    from jaxmpc.report.content import Table
    from jaxmpc.status import Status
    from jaxmpc.terminal.tables import number, show
    from tuning.trials import motion_of
    from tuning.trials.report import draws, pairs, ranked

    count, motions = len(found.status), np.array([motion_of(i) for i in range(len(found.status))])
    verdicts = {"lost": found.lost, "left |e| < 2 N": found.left, "swinging": found.swinging}
    rows, reasons = [], []
    for c, name in enumerate(names):
        for verdict, which in verdicts.items():
            hits = int(which[:, c].sum())
            low, high = (f"{100 * share:.3f}" for share in binomtest(hits, count).proportion_ci(method="wilson"))
            hearts = f"{len(set(motions[which[:, c]]))} of {len(set(motions))}"
            rows.append([name, verdict, str(hits), f"{100 * hits / count:.2f}", f"{low}–{high}", hearts])
        counts = [(kind.name, int(np.sum(found.status[:, c] == kind))) for kind in Status if kind != Status.OK]
        counts.append(("|e| ≥ 2 N in a loop that is unstable or grows", int(np.sum((found.lost & found.beyond)[:, c]))))
        if found.lost[:, c].any():
            reasons.append(f"{name} lost: {', '.join(f'{reason} {cases}' for reason, cases in counts if cases)}")
    told = ("controller", "verdict", "trials", "%", "95 % interval %", "on motions")
    verdicts_told = Table(told, rows)
    show(f"verdicts on {job.spread.arms} arms", told, rows)
    print("\n".join(reasons))
    rows = []
    for c, (name, params) in enumerate(zip(names, job.controllers, strict=True)):
        fields = found.peak_error, found.swing, found.rms, found.true_rms
        # What did not last counts as worse than all that did.
        peak, swing, *residuals = (np.nan_to_num(field[:, c].max(axis=-1), nan=np.inf) for field in fields)
        # Of the sorted values, not between them: some may be infinite.
        spans = [*np.quantile(peak, (0.99, 1.0), method="lower"), *np.quantile(swing, (0.5, 0.95), method="lower")]
        medians = [np.quantile(field, 0.5, method="lower") for field in residuals]
        figures = [number(value, 3) for value in (*medians, *spans)]
        rest = f"{100 * found.at_rest[:, c].mean():.2f}" if params.guarded else "–"
        rows.append([name, *figures, rest])
    measured = ("RMS N, median", "true", "|e| N, 99 %", "largest", "swing N, median", "95 %", "guard at rest %")
    show("figures of the worst axis", ("controller", *measured), rows)
    if len(names) == 2:
        both, first, second, neither = pairs(found.lost)
        print(
            f"lost in the same trial: both {both}, only {names[0]} {first}, only {names[1]} {second}, neither {neither}"
        )
        kept = ~found.lost.any(axis=1)
        for kind, field in (("RMS", found.rms), ("true RMS", found.true_rms)):
            worst = field[kept].max(axis=-1)
            if len(worst):
                low, middle, high = 100.0 * np.quantile(1.0 - worst[:, 0] / worst[:, 1], (0.05, 0.5, 0.95))
                lower = f"lower than with {names[1]}: median {middle:.0f} %, 90 % of them {low:.0f} to {high:.0f} %"
                print(f"{kind} of the worst axis, in the {kept.sum()} trials where neither is, {lower}")
    for c, name in enumerate(names):
        print(f"\nworst trials of {name}")
        for i in ranked(found, c, LISTED):
            largest, status = found.peak_error[i, c].max(), Status(int(found.status[i, c]))
            print(f"  {i:>6}  {status.name:<11} |e| {number(largest, 2)} N  {draws(job.trial(i))}")
    return verdicts_told


def _files(folder: Path, job: "Job", drawn: "Drawn", names: list[str], found: "Outcomes", verdicts: "Table") -> None:
    from jaxmpc.report.page import write_report
    from tuning.trials.report import draws, ranked, trials_report, write_csv, write_trial

    written = [folder / "trials.csv", folder / "trials.html"]
    write_csv(written[0], drawn, names, found)
    write_report(trials_report(job, drawn, names, found, verdicts), written[1])
    for which, c in (("worst", 0), ("worst-against", 1))[: len(names)]:
        i = ranked(found, c, 1)[0]
        trial = job.trial(i)
        written.append(folder / f"{which}.toml")
        write_trial(written[-1], trial, f"Trial {i}, seed {job.seed}, the worst of {names[c]}: {draws(trial)}")
    print("written: " + ", ".join(map(str, written)))
