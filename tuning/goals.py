"""Hard goals on the margins, each a number that is below 1 where the goal is met."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.stability import Margins

UNITS: Mapping[str, str] = {
    "M_s": "",
    "gain_margin_db": "dB",
    "gain_reduction_db": "dB",
    "phase_margin_deg": "deg",
    "delay_margin_s": "s",
}
"""Margins that may be goals: M_s is a ceiling, the others are floors."""


class Standing(NamedTuple):
    """How a loop stands to its goals."""

    normalised: Float[Array, "goals ..."]
    """M_s/limit or limit/margin [-]: at most 1 where met, ∞ where unstable."""
    violation: Float[Array, "..."]
    """What is to be brought to zero [-], summed over goals and stiffness; see `standing`."""


def standing(margins: Margins, limits: Mapping[str, float], headroom: float = 0.0) -> Standing:
    r"""Goals of one controller over its stiffnesses, stability first; traceable, differentiable.

        violation = Σ max(0, 1 − 1/g + headroom)   where every stiffness is stable, g the normalised goal
                  = Σ max(0, log ρ) + 1 per goal and stiffness   where one is not

    1 − 1/g grows from 0 at the limit to 1 at the edge of stability and has a finite slope all the way. Beyond
    that edge margins mean nothing (M_s is ∞ and has no slope), so the spectral radius ρ alone leads back.

    Args:
        margins: Over the stiffnesses, each field (stiffness,).
        limits: Limit per goal, a key of `UNITS`.
        headroom: How far inside its limit a goal is aimed at [-].
    """
    inverse = jnp.stack(
        [limit / margins.M_s if name == "M_s" else getattr(margins, name) / limit for name, limit in limits.items()]
    )
    stable = margins.spectral_radius < 1.0
    inverse = jnp.where(stable, inverse, 0.0)
    missed = jnp.sum(jnp.maximum(1.0 - inverse + headroom, 0.0))
    outside = jnp.sum(jnp.maximum(jnp.log(margins.spectral_radius), 0.0)) + inverse.size
    return Standing(1.0 / inverse, jnp.where(jnp.all(stable), missed, outside))
