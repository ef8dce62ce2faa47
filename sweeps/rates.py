"""How fast this machine has computed what kind of rows: recorded after every run, so that an estimate needs no run."""

import json
import math
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.files.foreign import table_if_any
from jaxmpc.files.sealed import write_atomic
from jaxmpc.terminal.process import users_cache
from sweeps.blocks import block_of, in_pairs, padded, programs, shares_signals
from sweeps.engines import Devices, engine_of
from sweeps.met import samples_met
from sweeps.pace import Pace
from sweeps.plan import Plan

LENGTHS = ("duration", "sampling_time")
"""Axes along which rows differ in their samples."""
COSTS = ("physics", "arm.substeps", "arm.integrator")
"""Axes along which samples differ in what they cost."""
FOREIGN = 4.0
"""An estimate from runs whose length differs by more than this factor is said to be one."""


class CostEstimate(NamedTuple):
    """What a sweep will take."""

    start_s: float
    """Until the end of the first round, beyond its own work [s]."""
    rate: float
    """Rows per second after that [1/s]."""
    rows: int
    """Rows that are run, those that fill up blocks included."""
    like: str
    """From what it was taken."""
    remembered: bool
    """Whether its program has been compiled before, and is loaded."""

    @property
    def seconds(self) -> float:
        """All of it [s]."""
        return self.start_s + self.rows / self.rate


def kept_in() -> Path | None:
    """The file of recorded rates, in the user's cache; None where there is none."""
    cache = users_cache()
    return None if cache is None else cache / "rates.json"


def record(plan: Plan, pace: Pace, devices: Devices, where: Path | None = None) -> None:
    """Note how long rows took, if all cost the same; a cache that cannot be written costs an estimate, nothing more."""
    path = where or kept_in()
    if path is None or not pace.rows or uneven(plan):
        return
    per_row = pace.seconds / pace.rows
    table = table_if_any(path)
    kind, samples = kind_of(plan, devices), f"{samples_of(plan):.0f}"
    before = _known(table, kind).get(samples)
    start_s, compile_s = (
        max(pace.first_s - per_row * block_of(plan) * devices.number - pace.compiling.spent, 0.0),
        pace.compiling.anew,
    )
    if before is not None and not compile_s:
        # This very process had the program already.
        _, start_s, compile_s = before
    table[kind] = {**_known(table, kind), samples: [per_row, start_s, compile_s]}
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, json.dumps(table, indent=1, sort_keys=True).encode())


def estimate(plan: Plan, devices: Devices, where: Path | None = None) -> CostEstimate | None:
    """What a sweep will take on this machine; None where nothing like it has been run, or samples differ in cost.

    Args:
        plan: What is swept.
        devices: What computes.
        where: File of the rates; None is the user's.
    """
    import jax

    path = where or kept_in()
    known = _known({} if path is None else table_if_any(path), kind_of(plan, devices))
    if not known or _swept(plan, COSTS):
        return None
    samples = samples_of(plan)
    nearest = min(known, key=lambda name: abs(math.log(int(name) / samples)))
    per_row, start_s, compile_s = known[nearest]
    config: Any = jax.config
    remembered = int(nearest) == samples and config.jax_enable_compilation_cache
    rows = padded(plan, devices.number, 0, len(plan.rows))
    ratio = int(nearest) / samples
    like = "runs like it on this machine" if 1 / FOREIGN < ratio < FOREIGN else "shorter or longer runs on this machine"
    compiling = 0.0 if remembered else compile_s * programs(plan)
    return CostEstimate(start_s + compiling, ratio / per_row, rows, like, remembered)


def _known(table: Mapping[str, Any], kind: str) -> dict[str, list[float]]:
    """By samples: time of a row, of starting with a program that is remembered, and what compiling adds [s]."""
    found = table.get(kind)
    items = found.items() if isinstance(found, dict) else ()
    return {name: each for name, each in items if name.isdecimal() and int(name) and _times(each)}


def _times(found: Any) -> bool:
    """Whether these are the three of them, that of a row above nought."""
    if not (isinstance(found, list) and len(found) == 3 and all(type(time) in (int, float) for time in found)):
        return False
    return found[0] > 0.0 and all(0.0 <= time < math.inf for time in found)


def kind_of(plan: Plan, devices: Devices) -> str:
    """What rows must have in common to be equally fast, per sample of a tissue."""
    experiment, params = plan.canonical["experiment"], plan.canonical["params"]
    arm, on_arm = experiment["arm"], experiment["physics"] != "linear"
    way = ("pairs, signals shared" if shares_signals(plan) else "pairs") if in_pairs(plan) else f"{block_of(plan)}"
    parts = [
        devices.kind,
        f"{devices.number} devices",
        engine_of(plan),
        experiment["physics"],
        plan.canonical["precision"],
        f"blocks {way}",
        params["architecture"],
        f"{len(params.get('knots', ()))} knots",
        "guarded" if params["guarded"] else "",
        f"{arm['substeps']} substeps {arm['integrator']}" if on_arm else experiment["damping"],
        "cable" if on_arm and arm["cable_hz"] else "",
        experiment["tissue"]["kind"] if on_arm else "",
        "preview" if experiment["reference"]["preview"] else "",
    ]
    return ", ".join(part for part in parts if part)


def samples_of(plan: Plan) -> float:
    """Samples of a row, over all tissues; their mean where rows differ."""
    if not _swept(plan, LENGTHS):
        return float(samples_met(plan, {"row": plan.rows[:1]})[0])
    return float(np.mean(samples_met(plan, {"row": plan.rows, **plan.space.columns(plan.rows)})))


def uneven(plan: Plan) -> bool:
    """Whether rows cost more than others, so that how long some took tells nothing of another sweep."""
    return _swept(plan, (*LENGTHS, *COSTS))


def _swept(plan: Plan, names: Collection[str]) -> bool:
    return any(axis.name in names for axis in plan.space.axes)
