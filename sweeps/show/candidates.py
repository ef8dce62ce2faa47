"""The rows of a sweep as a report takes them, and the params.toml of each."""

import re

import numpy as np

from jaxmpc.files.toml import toml_text
from jaxmpc.quantities import METRICS, PARAMETERS
from jaxmpc.report.content import Candidates, Measure, Swept, measure
from jaxmpc.report.influence import influence
from jaxmpc.status import Status
from sweeps.axis import SweepAxis, whole
from sweeps.goal import MEASURED
from sweeps.result import Result
from sweeps.show.best_rows import RESIDUALS, goal_of

GOALS = ("rms", "M_s", "chatter")
"""What the Pareto front shows first."""


def candidates(result: Result, max_M_s: float | None = None) -> Candidates:
    """The rows of a sweep as a report takes them.

    Args:
        result: The sweep.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
    """
    swept = [_axis(axis, result[axis.name]) for axis in result.axes]
    limits = goal_of(result, max_M_s).constraints
    ok = result["status"] == Status.OK
    found: list[Measure] = []
    for name in result.plan.kept:
        values = np.where(ok[..., None], result[name], np.nan) if name in METRICS else result[name]
        found.append(measure(MEASURED[name], values, limits.get(name)))
    # What is the same everywhere, as the clamped share of the linear loop, tells nothing.
    named = {*GOALS, *result.goal.names}
    told = [each for each in found if each.name in named or len(np.unique(each.values[np.isfinite(each.values)])) > 1]
    best = result.goal.best
    # A residual across another one is a line.
    others = [name for name in GOALS if name != best and not {name, best} <= set(RESIDUALS)]
    shown = [name for name in (best, *others) if any(each.name == name for each in told)]
    return Candidates(
        names=[f"row {row}" for row in result["row"]],
        measures=[*swept, *told],
        status=result["status"],
        tissues=[f"{K_s:g} N/m" if K_s == K_s else f"tissue {k + 1}" for k, K_s in enumerate(result.plan.stiffness)],
        goals=shown[:3],
        toml=template(result),
        influence=influence(swept, told) if len(result) > 1 else {},
    )


def _axis(axis: SweepAxis, values: np.ndarray) -> Measure:
    """A swept parameter; of a choice the places of its values, which its text names."""
    if axis.name in PARAMETERS and axis.numeric and not axis.relative:
        return measure(PARAMETERS[axis.name], values)
    text = "of the base's" if axis.relative else "of the world" if axis.of_world else "of the controller"
    text = text if axis.numeric else _words(axis)
    counts = not axis.numeric or (whole(axis.name) and not axis.relative)
    return Measure(axis.name, axis.name, axis.unit, text, values, "parameter", whole=counts)


def _words(axis: SweepAxis) -> str:
    """What the places of a choice stand for."""
    return "; ".join(f"{k}: {axis.label(k)}" for k in range(len(axis.values)))


def template(result: Result) -> list[str | Swept]:
    """A params.toml with places for the swept parameters; empty where a row's cannot be told from its columns.

    Args:
        result: The sweep.
    """
    own = [axis for axis in result.axes if not axis.of_world]
    if any(axis.relative or not axis.numeric for axis in own):
        return []
    text = toml_text({"params": result.plan.base.to_dict() | {axis.name: f"<{axis.name}>" for axis in own}})
    pieces = re.split(r'"<(\w+)>"', text)
    head: list[str | Swept] = ["# ", Swept("row"), f" of a sweep, spec {result.plan.spec_hash}\n"]
    for axis in result.axes:
        if axis.of_world:
            means = "" if axis.numeric else f" ({_words(axis)})"
            head += [f"# It met {axis.name} = ", Swept(axis.name), f"{means}{' times the base' * axis.relative}\n"]
    head.append("# Freeze it: jaxmpc freeze params.toml -o controller.npz\n")
    return [*head, *(Swept(piece) if k % 2 else piece for k, piece in enumerate(pieces))]
