"""The precision of a sweep that names none: that of its folder, or the one that suits what computes here."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import jax

from sweeps import store
from sweeps.engines import engine_of
from sweeps.plan import make_plan
from sweeps.rates import samples_of
from sweeps.spec import SweepSpec
from sweeps.tables import Precision

HALF_RATE = frozenset({"6.0", "7.0", "8.0", "9.0", "10.0"})
"""Compute capabilities of NVIDIA's GPUs for servers, P100 to B200, that do half as much in float64 as in float32
(CUDA C++ Programming Guide, "Throughput of Native Arithmetic Instructions"); most others do a thirty-second or less."""
MOST = {("linear", False): 3e11, ("linear", True): 3e10, ("wam", False): 1e10, ("wam", True): 3e9}
"""Samples of the loop for which float64 takes some three seconds longer than float32 with its rows that run once more,
by physics and whether gains are scheduled: whole commands on an H200, compiled; of the linear loop's 3e11, where a
quarter took 0.3 s longer, by the kernel's rates."""


def with_precision(spec: SweepSpec, folder: Path) -> SweepSpec:
    """The same sweep with a precision.

    Where a folder has been begun, whoever goes on computes as it was begun. A new sweep is in float64, where nothing is
    chance, if the kernel runs all of it on a GPU made for that, and takes little longer; any other is in float32.

    Args:
        spec: What is swept.
        folder: Where its results go.
    """
    if spec.precision is not None:
        return spec
    return replace(spec, precision=_begun(folder) or ("float64" if _costs_little(spec) else "float32"))


def _begun(folder: Path) -> Precision | None:
    """That of a folder; None where there is none or a changed one, which is told when rows are looked for."""
    there = store.read_manifest(folder).get("spec")
    if isinstance(there, dict) and isinstance(refined := there.get("sweep"), dict):
        there = refined
    found = there.get("precision") if isinstance(there, dict) else None
    return next((known for known in get_args(Precision) if known == found), None)


def _costs_little(spec: SweepSpec) -> bool:
    # A refined one has stages of other lengths and physics.
    if spec.refine is not None or not _half_rate():
        return False
    # Whatever engine somebody names: of results it decides last bits alone.
    plan = make_plan(replace(spec, engine=None))
    worlds = {axis.name: axis.values for axis in plan.space.axes}.get("physics", (spec.experiment.physics,))
    physics = "linear" if set(worlds) == {"linear"} else "wam"
    samples = len(plan.rows) * samples_of(plan)
    return engine_of(plan) == "kernel" and samples <= MOST[physics, spec.params.listening is not None]


def _half_rate() -> bool:
    return getattr(jax.local_devices()[0], "compute_capability", "") in HALF_RATE
