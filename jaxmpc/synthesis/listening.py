"""How the stiffness of the tissue is found for a family of controllers, in engineering units."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from numbers import Real
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.files.errors import InputError, nearest, within
from jaxmpc.files.toml import without_arrays
from jaxmpc.law.gains import KNOTS_APART
from jaxmpc.law.stiffness import StiffnessIdentification

BOUNDS: Mapping[str, tuple[float, float, str]] = {
    "amplitude": (0.01, 1.0, "N"),
    "frequency": (5.0, 100.0, "Hz"),
    "lock_in": (0.05, 10.0, "s"),
    "averaging": (0.1, 30.0, "s"),
    "confidence": (1.0, 20.0, "-"),
    "band": (0.01, 0.5, "-"),
    "prediction": (0.001, 0.2, "s"),
    "watching": (0.05, 10.0, "s"),
    "harmonics": (0, 16, "(a whole number)"),
    "beats": (1.0, 100.0, "-"),
}
BEYOND = 0.25
"""How far K̂ may leave the outer knots [-]."""


@dataclass(frozen=True)
class Listening:
    """Where the knots of a family stand, and the settings of `jaxmpc.law.identification`.

    Attributes:
        stiffness: For which K̂ each knot is, rising [N/m].
        amplitude: Of the sine that is added to the wanted force while the stiffness is not known [N]. By default its
            RMS is just below what counts as swinging, 0.1 N.
        frequency: Of it, above whatever a heart does [Hz].
        lock_in: Time constant of each low-pass of the lock-in [s].
        averaging: Memory of what it hears besides the sine [s].
        confidence: Half width of the interval over its standard deviation [-].
        band: Largest relative half width that counts as known [-].
        prediction: Time constant of the watch's filters [s].
        watching: Memory of the watch [s].
        harmonics: Up to which one what beats of the heart repeat is learned [-]; 0 learns nothing.
        beats: In how many beats most of it is learned [-].

    Raises:
        InputError: A value is of the wrong kind or out of bounds, or the stiffnesses do not rise.
    """

    stiffness: tuple[float, ...]
    amplitude: float = 0.14
    frequency: float = 17.0
    lock_in: float = 0.4
    averaging: float = 0.7
    confidence: float = 4.0
    band: float = 0.06
    prediction: float = 0.0035
    watching: float = 1.0
    harmonics: int = 7
    beats: float = 2.5

    def __post_init__(self) -> None:
        places = _numbers(self.stiffness)
        object.__setattr__(self, "stiffness", places)
        rising = all(KNOTS_APART * low <= high for low, high in pairwise(places))
        if not places or not rising or not all(math.isfinite(K) and 1.0 <= K <= 1e6 for K in places):
            bound = "rising, each in [1, 1e6] N/m and 0.1 % or more above the one before"
            raise InputError("listening.stiffness", list(places), bound, "One for every knot.")
        for name, (low, high, unit) in BOUNDS.items():
            value = without_arrays(getattr(self, name))
            kind = int if name == "harmonics" else int | float
            if isinstance(value, bool) or not (isinstance(value, kind) and low <= value <= high):
                raise InputError(f"listening.{name}", value, within(low, high, unit), "Leave it out.")
            object.__setattr__(self, name, value)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "Listening":
        """Settings from plain values; unnamed ones are the defaults.

        Raises:
            InputError: A name is unknown, a value of the wrong kind or out of bounds.
        """
        known = [field.name for field in fields(Listening)]
        for name in values:
            if name not in known:
                raise InputError(f"listening.{name}", values[name], "a known setting", nearest(name, known))
        return Listening(**{"stiffness": (), **values})

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as `from_dict` takes them."""
        return {**asdict(self), "stiffness": list(self.stiffness)}

    def constants(self, T_s: Any) -> StiffnessIdentification:
        """Constants of the law for a sampling time [s]; traceable."""
        angle = 2.0 * math.pi * self.frequency * T_s
        pole = jnp.exp(-T_s / self.prediction)
        # A fading-memory filter of second order has all its poles at one place (Morrison, Tracking Filter Engineering).
        value, rate, curve = 1.0 - pole**3, 1.5 * (1.0 - pole**2) * (1.0 - pole), (1.0 - pole) ** 3
        found = StiffnessIdentification(
            T_s=T_s,
            amplitude=self.amplitude,
            turn=(jnp.cos(angle), jnp.sin(angle)),
            mixing=1.0 - jnp.exp(-T_s / self.lock_in),
            averaging=1.0 - jnp.exp(-T_s / self.averaging),
            confidence=self.confidence,
            band=self.band,
            least=math.log(self.stiffness[0]) - BEYOND,
            most=math.log(self.stiffness[-1]) + BEYOND,
            prediction=(value, rate / T_s, curve / T_s**2),
            watching=1.0 - jnp.exp(-T_s / self.watching),
        )
        constants: StiffnessIdentification = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), found)
        return constants


def _numbers(places: Any) -> tuple[float, ...]:
    """Stiffnesses of a file or of a caller as floats [N/m].

    Raises:
        InputError: They are something else.
    """
    given = without_arrays(places)
    if not isinstance(given, list | tuple) or not all(isinstance(K, Real) and not isinstance(K, bool) for K in given):
        raise InputError("listening.stiffness", places, "numbers [N/m]", "One for every knot.")
    return tuple(map(float, given))
