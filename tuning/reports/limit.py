"""The tuned controller beside the least residual of any linear law that keeps the job's own goals."""

import math

from jaxmpc.limit.comparison import cells, told
from jaxmpc.limit.least import Demands
from jaxmpc.report.content import Section, Table
from tuning.proof.result import TuneResult

MILLI = 1e3


def limit_section(result: TuneResult) -> Section:
    """Residual over limit on each tissue and axis of the job's experiment, both from spectra; flown where it learns.

    Raises:
        InputError: The solver is not installed, or no linear law keeps the goals.
    """
    spec = result.spec
    demands = Demands(spec.held.get("M_s", math.inf), spec.held.get("chatter", math.inf))
    found = list(cells(spec.experiment, demands, result.params))
    lines = []
    for cell in found:
        least, yours = cell.limit.reached, cell.yours
        parts = (least.rms, least.motion, least.friction, least.noise, least.true_rms)
        left = cell.flown if cell.flown is not None else yours.rms if yours else math.nan
        numbers = [f"{MILLI * value:.1f}" for value in (*parts, left)]
        lines.append([f"{cell.stiffness:g} {cell.axis.upper()}", *numbers, f"{cell.ratio:.2f}"])
    head = ("K_s [N/m], axis", "least", "motion", "friction", "noise", "true", "yours", "× limit")
    words = (
        f"Least residual of any linear law that knows the tissue, M_s ≤ {demands.M_s:g} and chatter ≤ "
        f"{demands.chatter:g} m/s², RMS in mN; what it leaves out: docs/limit.md."
    )
    return Section("The limit", [words, told(found, demands)], [Table(head, lines)])
