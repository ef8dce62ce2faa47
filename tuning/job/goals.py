"""Goals on margins and on what a run measures, each a number that is at most 1 where the goal is met."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.experiment import AXES
from jaxmpc.metrics import Metrics
from jaxmpc.stability import Margins

MARGINS: Mapping[str, str] = {
    "M_s": "",
    "gain_margin_db": "dB",
    "gain_reduction_db": "dB",
    "phase_margin_deg": "deg",
    "delay_margin_s": "s",
}
"""Margins that may be goals, and their units: M_s is a ceiling, the others are floors."""
OVERSHOOT = "overshoot"
"""Overshoot of the linear loop after a step of the reference, worst tissue, relative to the step [-]."""
PEAK = "peak_to_peak"
"""Where the names of those goals begin that only runs in time can see."""
_MEASURED = {"rms": "N", PEAK: "N", "effort": "m/s²", "chatter": "m/s²"}
MEASURED: Mapping[str, str] = {
    **{f"{name}{axis}": unit for name, unit in _MEASURED.items() for axis in ("", *(f"_{axis}" for axis in AXES))},
    "rms_ratio": "",
    f"{PEAK}_ratio": "",
    OVERSHOOT: "",
}
"""What may be a goal of the runs, and its unit: on every axis or on one; a ratio is to the start point's value in the
same scenario, tissue and axis. All are ceilings."""
UNITS: Mapping[str, str] = {**MARGINS, **MEASURED}


class Standing(NamedTuple):
    """How a loop stands to its margins."""

    normalised: Float[Array, "goals ..."]
    """M_s/limit or limit/margin [-]: at most 1 where met, ∞ where unstable."""
    inverse: Float[Array, "goals ..."]
    """Its inverse [-]: at least 1 where met, 0 where unstable."""
    violation: Float[Array, "..."]
    """What is to be brought to zero [-], summed over goals and stiffness; see `standing`."""


def standing(margins: Margins, limits: Mapping[str, Any], headroom: float = 0.0) -> Standing:
    r"""Margins of one controller over its stiffnesses, stability first; traceable, differentiable.

        violation = Σ max(0, 1 − 1/g + headroom)   where every stiffness is stable, g the normalised goal
                  = Σ max(0, log ρ) + 1 per goal and stiffness   where one is not

    1 − 1/g grows from 0 at the limit to 1 at the edge of stability and has a finite slope all the way. Beyond
    that edge margins mean nothing (M_s is ∞ and has no slope), so the spectral radius ρ alone leads back.

    Args:
        margins: Over the stiffnesses, each field (stiffness,).
        limits: Limit per goal, a key of `MARGINS`.
        headroom: How far inside its limit a goal is aimed at [-].
    """
    none = jnp.zeros((0, *margins.M_s.shape))
    rows = [limit / margins.M_s if name == "M_s" else getattr(margins, name) / limit for name, limit in limits.items()]
    inverse = jnp.stack(rows) if rows else none
    stable = margins.spectral_radius < 1.0
    inverse = jnp.where(stable, inverse, 0.0)
    missed = jnp.sum(jnp.maximum(1.0 - inverse + headroom, 0.0))
    outside = jnp.sum(jnp.maximum(jnp.log(margins.spectral_radius), 0.0)) + inverse.size
    return Standing(1.0 / inverse, inverse, jnp.where(jnp.all(stable), missed, outside))


def measured(
    metrics: Metrics, reference: Metrics, overshoot: Any, limits: Mapping[str, Any]
) -> dict[str, Float[Array, "... stiffness scenarios axes"]]:
    """Goals on what the runs measured, normalised; traceable, differentiable.

    Args:
        metrics: Each field (…, stiffness, scenarios, 3).
        reference: Of the start point, the same; a cell that is not a number there, where the start point was
            unstable, counts as met.
        overshoot: Relative to the step, (…, stiffness); needed for that goal alone [-].
        limits: Limit per goal, a key of `MEASURED`.

    Returns:
        Value over limit per goal [-], each (…, stiffness, scenarios, 1 or 3).
    """
    found = {}
    for name, limit in limits.items():
        stem, _, axis = name.rpartition("_")
        if name == OVERSHOOT:
            cells = overshoot[..., None, None]
        elif axis == "ratio":
            before = getattr(reference, stem)
            known = jnp.isfinite(before) & (before > 0.0)
            cells = jnp.where(known, getattr(metrics, stem) / jnp.where(known, before, 1.0), 0.0)
        elif axis in AXES:
            place = AXES.index(axis)
            cells = getattr(metrics, stem)[..., place : place + 1]
        else:
            cells = getattr(metrics, name)
        found[name] = cells / limit
    return found
