"""`jaxmpc demo`: the whole story in one go: paper → sweep → tune → arm → freeze → fly → replay, with pictures."""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.beside import Apart
from jaxmpc.cli.demo_summary import SETTLE, STIFFNESS, Arm, band, errors, millinewtons, summary, worst_tables
from jaxmpc.files.sealed import write_atomic

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact
    from deploy.flight.replay import Difference
    from deploy.twin.flight import TwinFlight
    from jaxmpc.synthesis.params import Params
    from sweeps.result import Result
    from tuning import TuneResult

UNSEEN_SEED = 1000
"""Motion on the arm; no tuner trains on it."""
SECONDS = 18.0
"""Length of the flight in contact [s]."""
APPROACH = 5.0
"""How much longer than the flight the simulation is [s]: a flight's heart beats before contact is made, and its seven
peaks do not repeat, so that only the same stretch of it leaves the same residual."""
FLOOR = {"M_s": 2.0}
"""Margins that the frozen family keeps, with the stiffness unknown and known."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("-o", "--output", type=Path, default=Path("demo"), help="folder for everything it makes (demo)")


def run(args: argparse.Namespace) -> int:
    """Tell the story; 1 when the tuner met no goals, or the flight ended otherwise or is not repeated by its replay."""
    from jaxmpc.files.outputs import check_folder
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    from jaxmpc import Params

    began = time.monotonic()
    folder: Path = args.output
    check_folder("-o", folder)
    folder.mkdir(parents=True, exist_ok=True)
    # All of the arm goes on beside the rest: a flight is as much Python as tuning is.
    with Apart(_of_the_arm, folder) as on_the_arm:
        with _step("1/6 the paper's design, both parameter sets, on Table I of the linear loop"):
            _paper(Params.published("text"), Params.published("printed"))
        with _step("2/6 linear loop, without the robot's limits: a sweep of 5120 controllers × 3 tissues"):
            swept = _sweep(folder)
        with _step("3/6 linear loop, without the robot's limits: autotuning by gradient, M_s ≤ 2 held at every tissue"):
            tuned = _tune(folder)
        if not tuned.feasible:
            print(tuned.unmet())
            return 1
        with _step("4/6 the arm within the robot's limits: text design, and a family that finds the stiffness"):
            arm, artifact, flight, repeated = on_the_arm.result()
            _tell_arm(arm)
        with _step("5/6 freeze that family for the robot"):
            _tell_frozen(folder, artifact)
        with _step("6/6 fly it in lock-step over the twin's beating heart, and replay the flight"):
            same = _tell_flight(flight, repeated)
    summary(folder, swept, tuned, arm, artifact, flight, time.monotonic() - began)
    return 0 if same and flight.ended.well else 1


@contextmanager
def _step(title: str) -> Iterator[None]:
    began = time.monotonic()
    print(f"\n── {title}", flush=True)
    yield
    print(f"   {time.monotonic() - began:.1f} s", flush=True)


def _example(folder: Path, name: str) -> Path:
    """A copy of a shipped spec, for the user to change and run again."""
    path = folder / name
    write_atomic(path, (resources.files("jaxmpc") / "examples" / name).read_bytes())
    return path


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
    show("", RESIDUAL_HEADER, rows, keys=2)


def _sweep(folder: Path) -> "Result":
    from sweeps.run import run as sweep
    from sweeps.show.best_rows import table
    from sweeps.show.report import sweep_report
    from sweeps.spec import SweepSpec

    result = sweep(SweepSpec.from_toml(_example(folder, "demo-sweep.toml")), folder / "sweep", progress=True)
    print(table(result, 3))
    counts = ", ".join(f"{count} {name}" for name, count in result.status_counts().items() if count)
    print(f"controller × tissue: {counts}; result sha256 {result.hash[:16]}…")
    # Curves of single rows would take compiling; `jaxmpc sweep report` computes them.
    sweep_report(result, folder / "sweep.html", curves=False)
    return result


def _tune(folder: Path) -> "TuneResult":
    from jaxmpc.terminal.layout import columns_of_output
    from tuning import TuneSpec, report, tune

    result = tune(TuneSpec.from_toml(_example(folder, "demo-tune.toml")), folder / "tune", progress=True)
    print(report(result, columns_of_output()))
    write_atomic(folder / "tuning-history.png", (folder / "tune" / "history.png").read_bytes())
    return result


def _of_the_arm(folder: Path) -> "tuple[Arm, Artifact, TwinFlight, list[Difference]]":
    """Simulate, freeze, fly and replay, each with what the one before it has made; in a process of its own."""
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    arm = _on_arm()
    artifact = _freeze(folder, arm)
    flight = _fly(folder, arm)
    _picture(folder, arm, flight)
    return arm, artifact, flight, _replay(folder, artifact)


def _on_arm() -> Arm:
    """Both on one tissue and on motion that no tuner saw, with traces."""
    from msgspec.structs import replace

    from jaxmpc import Experiment, Params, evaluate

    experiment = Experiment.published("family-wam").with_seed(UNSEEN_SEED)
    experiment = replace(experiment, stiffness=(STIFFNESS,), duration=APPROACH + SECONDS, settle=SETTLE)
    family, text = (evaluate(Params.published(name), experiment, trace=True) for name in ("family", "text"))
    return Arm(experiment, text, family)


def _tell_arm(arm: Arm) -> None:
    import numpy as np

    from jaxmpc import Status
    from jaxmpc.loop.arm import ArmSample

    for name, outcome in (("text", arm.text), ("family", arm.family)):
        status = Status(int(outcome.status[0])).name
        print(f"{name:<7} status {status}, residual X / Y / Z {millinewtons(outcome.metrics.rms[0])} mN")
    assert isinstance(arm.family.trace, ArmSample)
    believed = np.asarray(arm.family.trace.stiffness)[0, :, -1]
    print(f"tissue of {STIFFNESS:g} N/m, which the family took for {' / '.join(f'{K:.0f}' for K in believed)} N/m")


def _freeze(folder: Path, arm: Arm) -> "Artifact":
    from jaxmpc import Experiment, Params
    from jaxmpc.export.freezing import freeze_controller
    from jaxmpc.export.golden import read_in

    path = folder / "controller.npz"
    assert arm.family.trace is not None
    (run,) = read_in(arm.experiment, arm.family.trace._asdict())
    promised = Experiment.published("family-wam")
    return freeze_controller(path, Params.published("family"), promised, FLOOR, ideal=False, run=run)


def _tell_frozen(folder: Path, artifact: "Artifact") -> None:
    path = folder / "controller.npz"
    fixed, known = worst_tables(artifact)
    print(f"{path}: kind {artifact.kind}, {path.stat().st_size} bytes; 375 to 1900 N/m: worst M_s {fixed['M_s']:.2f}")
    print(f"with the stiffness known to {band(artifact)}: worst M_s {known['M_s']:.2f}")


def _fly(folder: Path, arm: Arm) -> "TwinFlight":
    from dataclasses import replace

    from deploy.twin.flight import fly
    from deploy.twin.scenario import twin_settings

    settings = twin_settings("family-wam", stiffness=STIFFNESS, gap=0.005, seed=UNSEEN_SEED)
    settings = replace(settings, motion=arm.experiment.motion)
    return fly(folder / "controller.npz", settings, "0,0,-5@2", SECONDS, folder / "flight.npz")


def _picture(folder: Path, arm: Arm, flight: "TwinFlight") -> None:
    from jaxmpc.pictures.flight_figure import flight_figure

    measured, _, _ = errors(arm, arm.text, flight)
    before = flight.time[: len(measured)], measured[:, 2]
    flight_figure(folder / "flight.png", flight.time, flight.signals, STIFFNESS, before, SETTLE)


def _replay(folder: Path, artifact: "Artifact") -> "list[Difference]":
    """The recorded inputs once more through the runtime, and each signal beside the recorded one."""
    from deploy.flight.inputs import inputs_of
    from deploy.flight.recorder import read
    from deploy.flight.replay import compare, through_runtime

    recording = read(folder / "flight.npz")
    inputs = inputs_of(recording, artifact, recording.header["artifact"])
    return compare(recording, inputs, through_runtime(inputs, artifact))


def _tell_flight(flight: "TwinFlight", repeated: "list[Difference]") -> bool:
    """Whether its replay is the same flight."""
    state = flight.ended.safety_state
    print(f"{SECONDS:g} s in contact; ended: {state.state}, {state.reason}\n{flight.said}")
    parted = [row.signal for row in repeated if row.parts]
    said = f"parts in {', '.join(parted)}" if parted else "the same"
    print(f"replay of {repeated[0].samples} samples in the runtime: {said}")
    return not parted
