"""The files of a tuning run."""

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc import __version__
from jaxmpc.experiment import Experiment
from jaxmpc.files.sealed import seal, write_atomic
from jaxmpc.files.toml import write_toml
from tuning.proof.flyable import freeze_command
from tuning.proof.result import TuneResult
from tuning.reports.explained import Study
from tuning.reports.figures import before_after_figure
from tuning.reports.page import html_report
from tuning.reports.text import report

HISTORY = "history.png"
"""Picture of the way to a result."""


def write(result: TuneResult, explaining: Future[Study], folder: Path, way: Future[None]) -> None:
    """Write experiment.toml and params.toml (if every goal is met), history.npz, report.txt, the figures, report.html.

    Args:
        result: What was found.
        explaining: What explains it.
        folder: Where they go.
        way: What draws `HISTORY` there meanwhile.
    """
    params, experiment = folder / "params.toml", folder / "experiment.toml"
    if not result.met:
        for path in (params, experiment):
            path.unlink(missing_ok=True)  # of an earlier run: whoever names the folder would take it for this one's
    else:
        comment = f"Tuned by jaxmpc. Freeze it: {freeze_command(result.spec, experiment.name)}"
        # Killed between the two, no controller stands beside another's experiment, or beside none.
        write_toml(experiment, tuned_on(result.spec.experiment), "What the controller beside this was tuned on.")
        write_toml(params, {"params": result.params.to_dict(), "provenance": provenance(result)}, comment)
    write_atomic(folder / "history.npz", history(result))
    write_atomic(folder / "report.txt", report(result).encode())
    before_after_figure(result, folder / "before_after.png")
    way.result()
    write_atomic(folder / "report.html", html_report(result, explaining.result()).encode())


def tuned_on(experiment: Experiment) -> dict[str, Any]:
    """An experiment as plain data that stands anywhere."""
    data = experiment.to_dict()
    if file := data["motion"]["file"]:
        data["motion"]["file"] = str(Path(file).resolve())
    return data


def provenance(result: TuneResult) -> dict[str, Any]:
    """Where the parameters come from and what was measured of them."""
    spec, (before, after) = result.spec, result.worst
    peaks = {kind: [float(x) for x in found.M_s[1]] for kind, found in result.margins.items()}
    known = result.known[1]
    return {
        "made_by": f"jaxmpc {__version__} tune",
        "spec_sha256": spec.digest,
        "experiment": spec.experiment.name,
        "train_seeds": list(spec.tune.train_seeds),
        "validation_seeds": list(spec.tune.validation_seeds),
        "heldout_seeds": list(spec.tune.heldout_seeds),
        "goals": {**spec.held, "ideal": spec.ideal, "soft": dict(spec.soft)},
        "stiffness": [float(K_s) for K_s in spec.judged_at],
        "M_s_as_run": peaks["as run"],
        "M_s_ideal": peaks["ideal"],
        **({} if known is None else {"M_s_known": float(known.margins.M_s.max())}),
        "heldout_worst_rms_before": before,
        "heldout_worst_rms_after": after,
    }


def history(result: TuneResult) -> bytes:
    """Every step as sealed arrays, up to its last iteration: engineering values of every iteration and start."""
    space = result.spec.space
    arrays: dict[str, np.ndarray] = {f"heldout_{name}": field for name, field in result.heldout._asdict().items()}
    for step in result.steps:
        state, iterations = step.state, step.state.iteration
        kept = ("score", "worst", "M_s", "hard", "soft", "incumbent")
        arrays |= {f"{step.name}/{name}": getattr(state, name)[:iterations] for name in kept}
        arrays |= {f"{step.name}/values": space.values(state.path[:iterations]), f"{step.name}/skipped": state.skipped}
    header = {"kind": "jaxmpc tuning history", "spec": result.spec.to_dict(), "names": space.names}
    return seal(header, arrays)
