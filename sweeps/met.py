"""What rows met of the experiment: numbers of it, how many samples they ran, and how long of that is scored."""

import math
from collections.abc import Mapping

import numpy as np

from jaxmpc.law.reference import place
from jaxmpc.quantities import AXES
from sweeps.plan import Plan
from sweeps.rows import world_of


def met(plan: Plan, columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """A number of the experiment that each row met, (rows,).

    Args:
        plan: What was swept.
        columns: Entries of its axes, (rows,) each, and a column "row" at least.
        name: The key.
    """
    value = np.full(len(columns["row"]), float(plan.canonical["experiment"][name]))
    for axis in plan.space.axes:
        if axis.name == name:
            value = columns[name] * (value if axis.relative else 1.0)
    return value


def samples_met(plan: Plan, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Samples that each row ran, over all tissues, (rows,); see `met` for the arguments."""
    steps = np.round(met(plan, columns, "duration") / met(plan, columns, "sampling_time"))
    samples: np.ndarray = np.maximum(1.0, steps) * len(plan.stiffness)
    return samples


def scored_time(plan: Plan, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Time that counts in the metrics, of the axis with the least, (rows,) [s]; see `met` for the arguments.

    It is what neither settles nor is a ramp of the reference.
    """
    settle, end = met(plan, columns, "settle"), met(plan, columns, "duration")
    least: np.ndarray = end - settle
    axes = tuple(axis for axis in plan.space.axes if axis.name.startswith("reference."))
    # All numbers are alike: a constant force has no ramp.
    entries = [columns[axis.name] if not axis.numeric else np.full(len(end), axis.values[0]) for axis in axes]
    # Of no columns numpy finds no unique rows, and of a million alike it takes half a second.
    found: list[list[float]] = [[]]
    which = np.zeros(len(end), int)
    if axes:
        table, which = np.unique(np.stack(entries, axis=1), axis=0, return_inverse=True)
        found = table.tolist()
    for i, chosen in enumerate(found):
        own = which.ravel() == i
        reference = world_of(plan.canonical["experiment"], axes, tuple(chosen))["reference"]
        for name in AXES:
            pieces = place(reference[name])
            ends = [*(piece.begin for piece in pieces[1:]), math.inf]
            ramps = [(piece.begin, stop) for piece, stop in zip(pieces, ends, strict=True) if piece.slope]
            lost = sum(np.clip(np.minimum(end[own], b) - np.maximum(settle[own], a), 0.0, None) for a, b in ramps)
            least[own] = np.minimum(least[own], (end - settle)[own] - lost)
    return least
