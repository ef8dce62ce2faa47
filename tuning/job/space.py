"""Where the tuner moves: an unconstrained number for each free parameter, of the controller or its knots.

    value = A⁻¹(low + (high − low) σ(4 s z / (high − low))),  A = log, or the identity for horizons

with `low` and `high` on the axis A: mid-way between the bounds one unit of z moves A(value) by the scale s, so
that one learning rate suits a parameter with sixteen decades of room and one with a factor of two.

The stiffness that a knot assumes is counted in the knot's own, so that its bounds, and a tie, suit every knot.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import expit

from jaxmpc.quantities import HORIZONS, PARAMETERS
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.structure import IDLE
from jaxmpc.xla.plain import library

Bounds = tuple[float, float]
EDGE = 1e-3
"""Start values are kept this share of the room away from their bounds, where the slope vanishes."""
FREE = tuple(name for name, row in PARAMETERS.items() if row.free)
"""Free by default."""
KNOTS = "knots."
"""What names of parameters of knots begin with: "knots.lam" for all of them, "knots.2.lam" for the second."""
FREE_OF_KNOTS = tuple(KNOTS + name for name in FREE if name not in (*HORIZONS, "K2"))
"""The same of a family. Damping and horizons of a knot hardly matter: its observer and its feedback damp."""
ASSUMED = "Khat_s"
OVER_OWN = (0.5, 2.0, 1.0)
"""Search of the stiffness that a knot assumes, over the knot's own [-]."""


class FreeParameter(NamedTuple):
    """One free parameter, or all entries of one diagonal."""

    name: str
    """Name in `PARAMETERS`; for knots `KNOTS` and, for one alone, its number from 1 on stand before it."""
    low: float
    high: float
    scale: float
    length: int
    """Entries of a diagonal; 0 is a scalar."""
    knots: tuple[int, ...] = ()
    """Knots that have it, tied if of several; empty for the controller itself."""

    @property
    def parameter(self) -> str:
        """Name in `PARAMETERS`."""
        return self.name.rpartition(".")[2]

    @property
    def whole(self) -> bool:
        """Whether it counts samples."""
        return self.parameter in HORIZONS

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return "-" if self.knots and self.parameter == ASSUMED else PARAMETERS[self.parameter].unit

    @property
    def log(self) -> bool:
        """Whether it moves in its logarithm."""
        return self.low > 0.0 and not self.whole

    def of(self, params: Params) -> Any:
        """Its value in a controller; of knots that are tied, in the first."""
        if not self.knots:
            return getattr(params, self.parameter)
        return getattr(params.knots[self.knots[0]], self.parameter) / self.counted_in(params, self.knots[0])

    def counted_in(self, params: Params, knot: int) -> float:
        """What a value of one is for a knot, in the parameter's unit."""
        assert params.listening is not None
        return params.listening.stiffness[knot] if self.parameter == ASSUMED else 1.0

    @property
    def size(self) -> int:
        """How many unconstrained numbers it takes."""
        return max(self.length, 1)

    def value(self, z: Any) -> Any:
        """Parameter value of unconstrained numbers; traceable of JAX's, and of NumPy's without a program."""
        low, room = self._room()
        xp = library(z)
        sigmoid = jax.nn.sigmoid if xp is jnp else expit
        along = low + room * sigmoid(4.0 * self.scale / room * z)
        return xp.exp(along) if self.log else along

    def unconstrained(self, value: Any) -> np.ndarray:
        """The inverse of `value`, a little inside of the bounds."""
        share = np.clip(self.share(value), EDGE, 1.0 - EDGE)
        z: np.ndarray = np.log(share / (1.0 - share)) * self._room()[1] / (4.0 * self.scale)
        return z

    def share(self, value: Any) -> np.ndarray:
        """How far a value lies from the lower bound towards the upper one, on the axis A [-]."""
        low, room = self._room()
        along = np.log(value) if self.log else np.asarray(value)
        found: np.ndarray = (along - low) / room
        return found

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

    @property
    def whole(self) -> Bool[np.ndarray, " size"]:
        """Which numbers of z count samples."""
        return np.repeat([axis.whole for axis in self.axes], [axis.size for axis in self.axes])

    def decode(self, z: Float[Array | np.ndarray, " size"], width: Any) -> Params:
        """Parameters of one vector; traceable of JAX's, and of NumPy's without a program.

        Without a guard, whatever the base has: what takes the gain back while a loop swings would hide the swing
        from a tuner.

        Args:
            z: Unconstrained.
            width: Softness of the horizons [samples]; at 1 they are rounded to whole samples, H_u ≤ H_p.
        """
        own: dict[str, Any] = {}
        knots: list[dict[str, Any]] = [{} for _ in self.base.knots]
        for axis, part in zip(self.axes, self._parts, strict=True):
            value = axis.value(z[part] if axis.length else z[part][0])
            if not axis.knots:
                own[axis.parameter] = value
            for i in axis.knots:
                knots[i][axis.parameter] = value * axis.counted_in(self.base, i)
        moved = tuple(_moved(knot, values, width) for knot, values in zip(self.base.knots, knots, strict=True))
        return replace(_moved(self.base, own, width), guarded=False, knots=moved)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Engineering values of vectors along the last dimension, horizons not rounded."""
        parts = [axis.value(z[..., part]) for axis, part in zip(self.axes, self._parts, strict=True)]
        return np.concatenate(parts, axis=-1)

    def encode(self, params: Params) -> np.ndarray:
        """The vector of one controller's free parameters."""
        entries = [np.broadcast_to(axis.unconstrained(np.asarray(axis.of(params))), axis.size) for axis in self.axes]
        return np.concatenate(entries)

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Random vectors (count, size), uniform within bounds on each axis; diagonals and knots start out alike."""
        generator = np.random.Generator(np.random.Philox(seed))
        drawn = np.empty((count, self.size))
        shares: dict[tuple[str, bool], np.ndarray] = {}
        for axis, part in zip(self.axes, self._parts, strict=True):
            key = axis.parameter, bool(axis.knots)
            if key not in shares:
                shares[key] = generator.uniform(0.02, 0.98, (count, 1))
            low, room = axis._room()
            along = low + room * shares[key]
            drawn[:, part] = axis.unconstrained(np.exp(along) if axis.log else along)
        return drawn

    def exact(self, z: np.ndarray) -> Params:
        """The controller that a vector stands for, horizons rounded, as plain arrays; guarded if the base is."""
        plain: Params = jax.tree.map(np.asarray, self.decode(z, 1.0))
        return replace(plain, guarded=self.base.guarded)


def _moved(params: Params, values: dict[str, Any], width: Any) -> Params:
    """One controller with some parameters replaced, its horizons whole where the width is 1."""
    found = params.numbers | values
    xp = library(found, width)
    found = {name: xp.asarray(value, np.float64) for name, value in found.items()}
    whole = {name: xp.round(found[name]) for name in HORIZONS}
    whole["Hu"] = xp.minimum(whole["Hu"], whole["Hp"])
    found |= {name: xp.where(width > 1.0, found[name], whole[name]) for name in HORIZONS}
    return replace(params, **found)


def usual(params: Params) -> list[str]:
    """What is free of a controller by default: of a family what its knots have, of others all that acts in them."""
    names = FREE_OF_KNOTS if params.knots else FREE
    return [name for name in names if name.rpartition(".")[2] not in IDLE.get(params.architecture, ())]


def axis_of(
    name: str, bounds: Bounds | None, diagonal: bool, order: int = 1, knots: tuple[int, ...] = ()
) -> FreeParameter:
    """The axis of one parameter.

    Args:
        name: Of the axis; a parameter, for knots with what stands before it.
        bounds: Its bounds; None takes the default ones.
        diagonal: Whether each entry of its diagonal is free by itself.
        order: Disturbance order of the controller.
        knots: Of which knots it is.
    """
    row = PARAMETERS[name.rpartition(".")[2]]
    low, high, scale = row.search_of_order.get(order, row.search)
    if knots and row.name == ASSUMED:
        low, high, scale = OVER_OWN
    low, high = bounds or (low, high)
    return FreeParameter(name, float(low), float(high), scale, row.entries if diagonal else 0, knots)
