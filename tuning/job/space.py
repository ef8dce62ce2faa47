"""Where the tuner moves: an unconstrained number for each free parameter, its bounds never left.

    value = A⁻¹(low + (high − low) σ(4 s z / (high − low))),  A = log, or the identity for horizons

with `low` and `high` on the axis A: mid-way between the bounds one unit of z moves A(value) by the scale s, so
that one learning rate suits a parameter with sixteen decades of room and one with a factor of two.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmpc.quantities import HORIZONS, PARAMETERS
from jaxmpc.synthesis.params import Params

EDGE = 1e-3
"""Start values are kept this share of the room away from their bounds, where the slope vanishes."""
FREE = tuple(name for name, row in PARAMETERS.items() if row.free)
"""Free by default."""


class FreeParameter(NamedTuple):
    """One free parameter, or all entries of one diagonal."""

    name: str
    low: float
    high: float
    scale: float
    length: int
    """Entries of a diagonal; 0 is a scalar."""

    @property
    def log(self) -> bool:
        """Whether it moves in its logarithm."""
        return self.low > 0.0 and self.name not in HORIZONS

    @property
    def size(self) -> int:
        """How many unconstrained numbers it takes."""
        return max(self.length, 1)

    def value(self, z: Array) -> Array:
        """Parameter value of unconstrained numbers."""
        low, room = self._room()
        along = low + room * jax.nn.sigmoid(4.0 * self.scale / room * z)
        return jnp.exp(along) if self.log else along

    def unconstrained(self, value: Any) -> np.ndarray:
        """The inverse of `value`, a little inside of the bounds."""
        low, room = self._room()
        along = np.log(value) if self.log else np.asarray(value)
        share = np.clip((along - low) / room, EDGE, 1.0 - EDGE)
        z: np.ndarray = np.log(share / (1.0 - share)) * room / (4.0 * self.scale)
        return z

    def _room(self) -> tuple[float, float]:
        low, high = np.log([self.low, self.high]) if self.log else (self.low, self.high)
        return float(low), float(high - low)


class SearchSpace:
    """The free parameters as one vector z, and the frozen rest.

    Args:
        base: Values of the frozen parameters, one controller.
        axes: The free ones.
    """

    def __init__(self, base: Params, axes: Sequence[FreeParameter]) -> None:
        self.base, self.axes = base, tuple(axes)
        ends = np.cumsum([axis.size for axis in self.axes])
        self.size = int(ends[-1])
        self._parts = [slice(end - axis.size, end) for axis, end in zip(self.axes, ends, strict=True)]

    @property
    def names(self) -> list[str]:
        """Names along z; entries of a diagonal are numbered from 1."""
        return [f"{axis.name}[{i + 1}]" if axis.length else axis.name for axis in self.axes for i in range(axis.size)]

    def decode(self, z: Float[Array, " size"], width: Any) -> Params:
        """Parameters of one vector; traceable.

        Without a guard, whatever the base has: what takes the gain back while a loop swings would hide the swing
        from a tuner.

        Args:
            z: Unconstrained.
            width: Softness of the horizons [samples]; at 1 they are rounded to whole samples, H_u ≤ H_p.
        """
        values: dict[str, Any] = {name: jnp.asarray(getattr(self.base, name), jnp.float64) for name in PARAMETERS}
        for axis, part in zip(self.axes, self._parts, strict=True):
            values[axis.name] = axis.value(z[part] if axis.length else z[part][0])
        whole = {name: jnp.round(values[name]) for name in HORIZONS}
        whole["Hu"] = jnp.minimum(whole["Hu"], whole["Hp"])
        values |= {name: jnp.where(width > 1.0, values[name], whole[name]) for name in HORIZONS}
        return replace(self.base, **values, guarded=False)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Engineering values of vectors along the last dimension, horizons not rounded."""
        parts = [axis.value(jnp.asarray(z[..., part])) for axis, part in zip(self.axes, self._parts, strict=True)]
        return np.asarray(jnp.concatenate(parts, axis=-1))

    def encode(self, params: Params) -> np.ndarray:
        """The vector of one controller's free parameters."""
        entries = [
            np.broadcast_to(axis.unconstrained(np.asarray(getattr(params, axis.name))), axis.size) for axis in self.axes
        ]
        return np.concatenate(entries)

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Random vectors (count, size), uniform between the bounds on each axis; a diagonal starts out constant."""
        generator = np.random.Generator(np.random.Philox(seed))
        drawn = np.empty((count, self.size))
        for axis, part in zip(self.axes, self._parts, strict=True):
            share = generator.uniform(0.02, 0.98, (count, 1))
            low, room = axis._room()
            along = low + room * share
            drawn[:, part] = axis.unconstrained(np.exp(along) if axis.log else along)
        return drawn

    def exact(self, z: np.ndarray) -> Params:
        """The controller that a vector stands for, horizons rounded, as plain arrays; guarded if the base is."""
        rounded = self.decode(jnp.asarray(z), 1.0)
        values: dict[str, Any] = {name: np.asarray(getattr(rounded, name)) for name in PARAMETERS}
        return replace(self.base, **values)


def axis_of(name: str, bounds: tuple[float, float] | None, diagonal: bool, order: int = 1) -> FreeParameter:
    """The axis of one parameter.

    Args:
        name: A parameter.
        bounds: Its bounds; None takes the default ones.
        diagonal: Whether each entry of its diagonal is free by itself.
        order: Disturbance order of the controller.
    """
    row = PARAMETERS[name]
    low, high, scale = row.search_of_order.get(order, row.search)
    low, high = bounds or (low, high)
    return FreeParameter(name, float(low), float(high), scale, row.entries if diagonal else 0)
