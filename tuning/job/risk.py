"""One number for many scenarios: how much the bad ones count."""

from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.files.errors import InputError
from jaxmpc.xla.extremes import greatest
from jaxmpc.xla.plain import library

ORDER = 24
"""Order of the mean that stands for the worst case: equal to it where all cells are, 10 % below for one of 12 alone."""
QUARTER = 0.25
"""Share of the worst unless a job gives another [-]."""


class Risk(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [risk]: how the scenarios are summed up."""

    kind: Literal["mean", "worst", "soft-worst", "cvar"] = "soft-worst"
    """"mean"; "worst", the maximum; "soft-worst", a mean of high order, whose slope knows all bad scenarios; "cvar",
    the mean of the worst part (Rockafellar and Uryasev 2000)."""
    share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None
    """That part, of "cvar" alone, where None is a quarter [-]."""

    def __post_init__(self) -> None:
        if self.kind == "cvar":
            msgspec.structs.force_setattr(self, "share", QUARTER if self.share is None else self.share)
        elif self.share is not None:
            remedy = f'Set kind = "cvar", or remove it: of "{self.kind}" there is no part.'
            raise InputError("risk.share", self.share, 'given for "cvar" only', remedy)

    def over(self, values: Float[Array | np.ndarray, "... scenarios"]) -> Any:
        """The risk of positive values along the last dimension, (…); traceable, differentiable."""
        match self.kind:
            case "mean":
                return library(values).mean(values, axis=-1)
            case "worst":
                return greatest(jnp.asarray(values))
            case "soft-worst":
                return soft_worst(values)
            case "cvar":
                assert self.share is not None
                return _worst_part(jnp.asarray(values), self.share)


@np.errstate(invalid="ignore")
def soft_worst(values: Float[Array | np.ndarray, "... cells"]) -> Any:
    """Mean of order `ORDER` along the last dimension: a maximum whose slope moves smoothly between cells.

    NaN where a cell is, whose run was lost.
    """
    xp = library(values)
    highest = xp.max(values, axis=-1, keepdims=True)
    highest = jax.lax.stop_gradient(highest) if xp is jnp else highest
    highest = xp.where(highest == 0.0, 1.0, highest)
    mean = xp.mean((values / highest) ** ORDER, axis=-1)
    safe = xp.where(mean == 0.0, 1.0, mean)
    return highest[..., 0] * xp.where(mean == 0.0, 0.0, safe ** (1.0 / ORDER))


def _worst_part(values: Array, share: float) -> Array:
    """Mean of the worst `share`; the scenario at its edge counts with the fraction that lies inside."""
    count = values.shape[-1]
    inside = jnp.clip(share * count - jnp.arange(count), 0.0, 1.0)
    worst_first = -jnp.sort(-values, axis=-1)
    return jnp.sum(inside * worst_first, axis=-1) / jnp.sum(inside)
