"""`jaxmpc demo`: the whole story in one go: paper → sweep → tune → freeze → replay, with pictures."""

import argparse
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxmpc.stability import Margins
    from jaxmpc.synthesis.params import Params
    from sweeps.result import Result
    from tuning import TuneResult

UNSEEN_SEED = 1000
"""Motion of the before/after figure; the tuner does not train on it."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("-o", "--output", type=Path, default=Path("demo"), help="folder for everything it makes (demo)")


def run(args: argparse.Namespace) -> int:
    """Tell the story; 1 when the tuner met no goals or the frozen controller is not the tuned one."""
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    from jaxmpc import Params

    began = time.monotonic()
    folder: Path = args.output
    folder.mkdir(parents=True, exist_ok=True)
    with _step("1/5 the paper's design, both parameter sets, on Table I of the linear loop"):
        text, printed = Params.published("text"), Params.published("printed")
        _paper(text, printed)
    with _step("2/5 a sweep of 10 240 controllers × 3 tissues"):
        swept = _sweep(folder)
    with _step("3/5 autotuning by gradient, M_s ≤ 2 held at every tissue"):
        tuned = _tune(folder)
    if not tuned.feasible:
        print(tuned.unmet())
        return 1
    with _step("4/5 before and after on the arm: friction, wrong masses, encoders, motion that the tuner did not see"):
        arm = _before_after(folder, text, tuned)
    with _step("5/5 freeze, and replay in the numpy runtime"):
        same = _freeze_and_replay(folder, tuned.params)
    _summary(folder, swept, tuned, arm, time.monotonic() - began)
    return 0 if same else 1


@contextmanager
def _step(title: str) -> Iterator[None]:
    began = time.monotonic()
    print(f"\n── {title}", flush=True)
    yield
    print(f"   {time.monotonic() - began:.1f} s", flush=True)


def _example(folder: Path, name: str) -> Path:
    """A copy of a shipped spec, for the user to change and run again."""
    with resources.as_file(resources.files("jaxmpc") / "examples" / name) as source:
        return Path(shutil.copyfile(source, folder / name))


def _paper(text: "Params", printed: "Params") -> None:
    from jaxmpc import Experiment, Params, evaluate
    from jaxmpc.terminal.tables import RESIDUAL_HEADER, residual_rows, show

    experiment = Experiment.published("table-1")
    outcome = evaluate(Params.stack([text, printed]), experiment, trace=True)
    rows: list[list[str]] = []
    for i, name in enumerate(("text, K̂_s 900", "printed, K̂_s 500")):
        one = outcome._replace(
            metrics=type(outcome.metrics)(*(x[i] for x in outcome.metrics)),
            margins=type(outcome.margins)(*(x[i] for x in outcome.margins)),
            status=outcome.status[i],
        )
        rows += residual_rows(name, one, experiment)
    show("", RESIDUAL_HEADER, rows)


def _sweep(folder: Path) -> "Result":
    from sweeps.heat import heat_map
    from sweeps.report import pareto_figure, table
    from sweeps.run import run as sweep
    from sweeps.spec import SweepSpec

    result = sweep(SweepSpec.from_toml(_example(folder, "demo-sweep.toml")), folder / "sweep", progress=True)
    print(table(result, 3))
    counts = ", ".join(f"{count} {name}" for name, count in result.status_counts().items() if count)
    print(f"controller × tissue: {counts}; result sha256 {result.hash[:16]}…")
    heat_map(result, folder / "sweep-heat-map.png", x="Khat_s", y="Q_p")
    pareto_figure(result, folder / "sweep-pareto.png")
    return result


def _tune(folder: Path) -> "TuneResult":
    from tuning import TuneSpec, history_figure, report, tune

    result = tune(TuneSpec.from_toml(_example(folder, "demo-tune.toml")), folder / "tune", progress=True)
    print(report(result))
    history_figure(result, folder / "tuning-history.png")
    return result


def _before_after(folder: Path, text: "Params", tuned: "TuneResult") -> tuple[float, float]:
    """Worst residual RMS of both controllers on the arm [N]; the tuner knew the linear loop alone."""
    import numpy as np

    from jaxmpc import Experiment, Params, Status, evaluate
    from jaxmpc.pictures.experiment_figures import before_after_figure

    # Tuned on the linear loop, it asks a robot for more than its limits allow (arm-robot-tune does not).
    experiment = Experiment.published("table-1-wam").with_seed(UNSEEN_SEED).without_limits()
    outcome = evaluate(Params.stack([text, tuned.params]), experiment, trace=True)
    before_after_figure(folder / "before-after.png", experiment, outcome)
    before, after = tuned.worst
    print(
        f"linear loop, worst residual RMS over tissue, axis and {tuned.heldout.rms.shape[1]} unseen motions: "
        f"{1e3 * before:.1f} → {1e3 * after:.1f} mN ({-100 * tuned.gain:+.0f} %)"
    )
    names = [Status(int(code)).name for code in np.max(outcome.status, axis=1)]
    worst = np.max(outcome.metrics.rms, axis=(1, 2))
    print(
        f"the arm without the robot's limits, one unseen motion: {1e3 * worst[0]:.1f} → {1e3 * worst[1]:.1f} mN "
        f"({100 * (worst[1] / worst[0] - 1.0):+.0f} %), status {names[0]} → {names[1]}"
    )
    return float(worst[0]), float(worst[1])


def _freeze_and_replay(folder: Path, params: "Params") -> bool:
    from deploy.controller.file import load
    from deploy.controller.golden import replay
    from jaxmpc import Experiment
    from jaxmpc.cli.freeze import freeze_controller

    path = folder / "controller.npz"
    freeze_controller(path, params, Experiment.published("table-1"), {"M_s": 2.0}, ideal=True)
    deviation, _ = replay(load(path))
    print(
        f"{path}: {path.stat().st_size} bytes; the numpy runtime repeats the JAX loop to {deviation:.0e} of its command"
    )
    return deviation < 1e-9


def _summary(folder: Path, swept: "Result", tuned: "TuneResult", arm: tuple[float, float], seconds: float) -> None:
    import numpy as np

    from jaxmpc.terminal.tables import number, show

    ideal, as_run = tuned.margins["ideal"], tuned.margins["as run"]
    before, after = tuned.worst
    best = swept.best(1, 2.0)
    own = np.searchsorted(tuned.spec.judged_at, np.asarray(tuned.spec.experiment.stiffness))
    peaks = [" / ".join(number(x, 2) for x in np.asarray(ideal.M_s)[i, own]) for i in range(2)]
    rows = [
        ["paper's text design", number(1e3 * arm[0], 1), number(1e3 * before, 1), peaks[0], *_worst(ideal, as_run, 0)],
        ["autotuned", number(1e3 * arm[1], 1), number(1e3 * after, 1), peaks[1], *_worst(ideal, as_run, 1)],
    ]
    header = (
        "controller",
        "arm mN",
        "linear mN",
        "M_s at 375/810/1900",
        "GM up/down dB",
        "PM °",
        "DM ms",
        "M_s as run",
    )
    print()
    show("worst residual RMS on unseen motion, without the robot's limits; margins of the ideal loop", header, rows)
    if len(best):
        print(f"best of the sweep with M_s ≤ 2 (table's motion): {1e3 * best.worst_rms[0]:.1f} mN")
    print(f"\neverything lies in {folder}/ ({seconds:.0f} s):")
    for path in sorted(folder.glob("*")):
        print(f"  {path}{'/' if path.is_dir() else ''}")


def _worst(ideal: "Margins", as_run: "Margins", which: int) -> list[str]:
    import numpy as np

    from jaxmpc.terminal.tables import number

    def least(name: str, digits: int, scale: float = 1.0) -> str:
        return number(scale * np.min(np.asarray(getattr(ideal, name))[which]), digits)

    return [
        f"{least('gain_margin_db', 1)} / {least('gain_reduction_db', 1)}",
        least("phase_margin_deg", 0),
        least("delay_margin_s", 1, 1e3),
        number(np.max(np.asarray(as_run.M_s)[which]), 2),
    ]
