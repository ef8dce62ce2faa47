"""How rows are cut into blocks, by the spec and the kind of device alone; needs no engine: a dry run is quick.

The bits of a row may depend on its block's size, so nothing else may decide it: not the number of cores or devices, not
the chunk, not who computes.
"""

import math
from itertools import pairwise

import numpy as np

from jaxmpc.xla.blocks import BLOCK, rows_of_a_block
from sweeps.plan import Plan
from sweeps.targets import STRUCTURAL, target

FEW = 32
"""Fewer controllers than this in a world are run as pairs."""
PROGRAMS = (
    *("physics", "damping", "duration", "sampling_time", "reference.preview"),
    *("tissue.kind", "tissue.attached", "arm.integrator", "arm.substeps"),
)
"""Keys of the experiment whose values are programs of their own."""
SMALLEST = 8
SIGNAL_BYTES = 2**27
"""Most memory of the signals of one block of pairs [bytes]."""


def in_pairs(plan: Plan) -> bool:
    """Whether every row is run with a scene of its own, not many controllers in one."""
    return plan.space.of_worlds and plan.space.same_world < FEW


def shares_signals(plan: Plan) -> bool:
    """Whether all scenes have the same signals and differ in numbers beside them."""
    return not any(target(axis.name).signals for axis in plan.space.axes)


def block_of(plan: Plan) -> int:
    """Rows of a block."""
    if not plan.space.of_worlds:
        return rows_of_a_block()
    if in_pairs(plan) and shares_signals(plan):
        return BLOCK
    if not in_pairs(plan):
        return min(BLOCK, _power_below(plan.space.same_world))
    return min(BLOCK, max(SMALLEST, _power_below(SIGNAL_BYTES // signal_bytes(plan))))


def signal_bytes(plan: Plan) -> int:
    """Size of the signals of one scene, whose steps are the base's [bytes]."""
    experiment = plan.canonical["experiment"]
    steps = round(experiment["duration"] / experiment["sampling_time"])
    ahead = 64 if experiment["reference"]["preview"] else 1
    per_axis = (4 if experiment["physics"] == "linear" else 6 + 2 * experiment["arm"]["substeps"]) + ahead
    return int(8 * 3 * steps * per_axis)


def padded(plan: Plan, devices: int, first: int, last: int) -> int:
    """Rows that are run where first … last − 1 are asked for: blocks are filled up, on every device.

    Args:
        plan: The sweep.
        devices: How many compute.
        first: Place of the first row among the planned ones.
        last: Place behind the last.
    """
    width = block_of(plan) * devices
    inside = [] if in_pairs(plan) else [bound for bound in plan.bounds.tolist() if first < bound < last]
    edges = [first, *inside, last]
    return sum(math.ceil((end - begin) / width) * width for begin, end in pairwise(edges))


def _power_below(number: int) -> int:
    """The largest power of two that is not larger; at least 1."""
    return 1 << max(number.bit_length() - 1, 0)


def programs(plan: Plan) -> int:
    """How many programs are compiled: one for each structure of controller and world among the rows."""
    swept = [axis.name for axis in plan.space.axes if axis.name in (*STRUCTURAL, *PROGRAMS)]
    if not swept:
        return 1
    columns = plan.space.columns(plan.rows)
    return len(np.unique(np.stack([columns[name] for name in swept], axis=1), axis=0))
