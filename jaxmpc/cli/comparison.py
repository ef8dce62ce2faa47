"""What a residual stands beside: the paper's Table I, and the two controllers that the cascade is made of."""

from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.experiment import AXES, Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.terminal.tables import number

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome
    from jaxmpc.synthesis.params import Params

TABLE_1 = {
    375.0: ((0.39, 0.08), (0.34, 0.06), (0.51, 0.09)),
    810.0: ((0.38, 0.08), (0.35, 0.06), (0.44, 0.08)),
    1900.0: ((0.39, 0.07), (0.35, 0.05), (0.39, 0.08)),
}
"""The paper's residuals: per stiffness [N/m] and axis, peak to peak and RMS [N]."""
PAPER_HEADER = (
    *("K_s N/m", "axis", "pp N", "paper", "deviation %", "RMS N", "paper", "deviation %"),
    *("true pp N", "true RMS N"),
)
OBSERVER, PREDICTOR = "AOB alone", "MPC alone"
"""What is left of the cascade without its other half."""


def paper_rows(outcome: "Outcome", experiment: Experiment) -> list[list[str]]:
    """Ours and the paper's, a row per axis and stiffness; none where the experiment is not that of Table I.

    Args:
        outcome: Of one controller.
        experiment: What was run.
    """
    if not _is_table_1(experiment):
        return []
    rows = []
    for i, stiffness in enumerate(experiment.stiffness):
        for axis, published in enumerate(TABLE_1.get(stiffness, ())):
            found = float(outcome.metrics.peak_to_peak[i, axis]), float(outcome.metrics.rms[i, axis])
            cells = []
            for value, paper, digits in zip(found, published, (2, 3), strict=True):
                cells += [number(value, digits), number(paper, 2), _percent(value / paper - 1.0)]
            true = outcome.metrics.true_peak_to_peak[i, axis], outcome.metrics.true_rms[i, axis]
            cells += [number(value, digits) for value, digits in zip(true, (2, 3), strict=True)]
            rows.append([f"{stiffness:g}", AXES[axis].upper(), *cells])
    return rows


def deviations(outcome: "Outcome", experiment: Experiment) -> np.ndarray:
    """RMS over the paper's, minus one, of every cell of Table I that was run and ended well, shape (cells,) [-]."""
    known = [i for i, stiffness in enumerate(experiment.stiffness) if stiffness in TABLE_1]
    if not known or not _is_table_1(experiment):
        return np.zeros(0)
    paper = np.array([TABLE_1[experiment.stiffness[i]] for i in known])[:, :, 1]
    cells = (np.asarray(outcome.metrics.rms)[known] / paper - 1.0).ravel()
    ended: np.ndarray = cells[np.isfinite(cells)]
    return ended


def parts(params: "Params") -> dict[str, "Params"]:
    """The observer alone and the MPC alone, by label.

    MPC alone is the published set "mpc-alone": the cascade's weights, chosen for the plant that the observer makes,
    do not suit the bare one, and beside a controller that does not work anything is good.

    Raises:
        InputError: The controller is no cascade with fixed gains.
    """
    from dataclasses import replace

    from jaxmpc.synthesis.params import Params

    if params.architecture != "mpc-aob":
        remedy = "Leave --compare out, or give a cascade."
        raise InputError("architecture", params.architecture, '"mpc-aob" with --compare', remedy)
    if params.listening is not None:
        remedy = "Leave --compare out, or put others beside it: `jaxmpc compare family cautious`, say."
        raise InputError("--compare", "a family", "asked of fixed gains", remedy)
    return {OBSERVER: replace(params, architecture="aob"), PREDICTOR: Params.published("mpc-alone")}


def reduction_rows(outcome: "Outcome", others: dict[str, "Outcome"], experiment: Experiment) -> list[list[str]]:
    """How much lower the cascade's RMS is than each other's, a row per other and stiffness: measured, then true.

    Args:
        outcome: Of the cascade.
        others: What it is measured against, by label.
        experiment: What was run.
    """
    rows = []
    for label, other in others.items():
        pairs = (outcome.metrics.rms, other.metrics.rms), (outcome.metrics.true_rms, other.metrics.true_rms)
        lower = np.hstack([1.0 - np.asarray(ours) / np.asarray(theirs) for ours, theirs in pairs])
        rows += [
            [label, f"{stiffness:g}", *map(_percent, lower[i])] for i, stiffness in enumerate(experiment.stiffness)
        ]
    return rows


REDUCTION_HEADER = ("against", "K_s N/m", "X %", "Y %", "Z %", "true X %", "true Y %", "true Z %")


def _is_table_1(experiment: Experiment) -> bool:
    """Whether it asks what the paper's Table I does: the harmonic table under 0, 0 and −5 N."""
    signals, motion = experiment.signals, experiment.motion
    constant = all(
        np.allclose(signals.force_ref[: experiment.steps, i][signals.score[:, i]], wanted)
        for i, wanted in enumerate((0.0, 0.0, -5.0))
    )
    return constant and motion.kind == "harmonics" and motion.scale == 1.0


def _percent(share: float) -> str:
    return "–" if np.isnan(share) else f"{100.0 * share:+.0f}".replace("-", "−")
