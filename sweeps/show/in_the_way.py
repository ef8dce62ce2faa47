"""What stands in the way where no row of a sweep is a good one."""

import numpy as np

from sweeps.goal import MEASURED, SweepGoal
from sweeps.result import Result


def in_the_way(result: Result, goal: SweepGoal) -> list[str]:
    """How many rows keep each limit by itself, and which row misses least, in sentences; none where a row is good.

    Args:
        result: The sweep.
        goal: Its own, or one with other limits.
    """
    if result.good(goal).any():
        return []
    fine = np.flatnonzero(result.ok)
    told = f"{len(fine)} of {len(result)} rows are OK at every stiffness"
    if not len(fine) or not goal.constraints:
        return [told]
    kept, excess = [], np.zeros((len(goal.constraints), len(fine)))
    for k, (name, limit) in enumerate(goal.constraints.items()):
        quantity, values = MEASURED[name], result.worst(name)[fine]
        beyond = values - limit if quantity.ceiling else limit - values
        best = int(np.argmin(beyond))
        count, where = int((beyond <= 0.0).sum()), f"(best {values[best]:.4g}, row {result['row'][fine[best]]})"
        kept.append(f"{count} keep{'s' * (count == 1)} {name} {quantity.sign} {limit:g} {where}")
        excess[k] = np.maximum(beyond, 0.0) / max(abs(limit), 1e-12)
    nearest = int(np.argmin(excess.max(axis=0)))
    missed = [
        f"{name} with {result.worst(name)[fine[nearest]]:.4g}"
        for name, each in zip(goal.constraints, excess, strict=True)
        if each[nearest] > 0.0
    ]
    told = f"{told}; of these {', '.join(kept)}"
    if not missed:  # what ranks is no number anywhere
        return [told]
    return [told, f"nearest is row {result['row'][fine[nearest]]}, which misses {', '.join(missed)}"]
