"""Linear margins of the controllers that trials are about, beside what came of them."""

from collections.abc import Sequence

import jax
import numpy as np
from msgspec.structs import replace

from jaxmpc import margins
from jaxmpc.experiment import Experiment
from jaxmpc.stability import Margins
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.stability.presliding import presliding_frequencies, presliding_peak
from jaxmpc.synthesis.params import Params
from jaxmpc.terminal.tables import number
from jaxmpc.xla.place import on_cpu
from tuning.trials.drawn import Job

TISSUES = 33
"""Stiffnesses, log-spaced, at which they are judged; a family's known ones where freezing judges them."""
COLUMNS = ("controller", "delay", "M_s", "at N/m", "GM up / down dB", "PM °", "DM ms", "M_s presliding", "at N/m")


@on_cpu()
def margins_table(names: Sequence[str], job: Job) -> list[list[str]]:
    """A row per controller and delay; a family has rows of its fixed gains, and of those where the tissue is known."""
    rows = []
    for name, params in zip(names, job.controllers, strict=True):
        kinds = {name: _of_fixed}
        if params.listening is not None:
            kinds = {f"{name}, fixed gains": _of_fixed, f"{name}, known": _of_known}
        for title, judged in kinds.items():
            for delay in job.spread.scenarios.delays:
                rows.append([title, str(delay), *judged(params, replace(job.base, delay=delay), job)])
    return rows


def _of_fixed(params: Params, base: Experiment, job: Job) -> list[str]:
    """As the loop runs, and with the joints' friction as springs."""
    tissues, path = np.geomspace(*job.spread.stiffness, TISSUES), base.loop_path()
    sticking = np.asarray(presliding_peak(params, tissues, presliding_frequencies(job.base), path))
    return [*_told(margins(params, tissues, path=path), tissues), *_peak(sticking, tissues)]


def _of_known(params: Params, base: Experiment, job: Job) -> list[str]:
    """With K̂ held at and between the knots, over the band of K_s/K̂ that the identification leaves open."""
    assert params.listening is not None
    known, ratios = judged_where(params.listening)
    found: Margins = jax.tree.map(np.ravel, family_margins(params, known, ratios, base.loop_path()))
    return [*_told(found, np.outer(known, ratios).ravel()), "–", "–"]


def _told(found: Margins, tissues: np.ndarray) -> list[str]:
    up, down, phase, late = (float(np.min(np.asarray(field))) for field in found[1:5])
    rest = f"{number(up, 1)} / {number(down, 1)}", number(phase, 0), number(1e3 * late, 1)
    return [*_peak(np.asarray(found.M_s), tissues), *rest]


def _peak(values: np.ndarray, tissues: np.ndarray) -> list[str]:
    """The largest, and on which tissue [N/m]."""
    return [number(values.max(), 2), f"{tissues[int(np.argmax(values))]:.0f}"]
